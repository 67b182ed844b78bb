// An image of the user's own, fitted once: dropped anywhere on the page, or chosen.
import { batch, signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { CENTRE, CONTOUR } from "../draw/colour";
import { sigmaOf } from "../draw/ellipse";
import { plain, withSigma } from "../format";
import { get, newestOnly, said, segment, sendImage } from "../state/api";
import { centreOf, models, session } from "../state/store";
import type { Estimate, ModelDocument } from "../types";

const image = signal<File | null>(null);
const model = signal("");
/** What was found, for the image and the model that are chosen; nothing while that is being fitted. */
const answer = signal<{ estimates: Estimate[]; document: ModelDocument } | null>(null);
const fault = signal("");
const isWorking = signal(false);
/** Of a folder that was dropped: the images that are not shown. */
const others = signal<File[]>([]);

/** Takes what was dropped; whether there was an image in it. */
export function take(files: Iterable<File>): boolean {
  const all = [...files];
  const images = all.filter((file) => /^image\/(png|jpeg)$/.test(file.type)).sort((a, b) => a.name.localeCompare(b.name));
  if (!images[0]) {
    fault.value = `${all[0]?.name ?? "That"} is no PNG or JPEG.`;
    return false;
  }
  others.value = images;
  fit(images[0]);
  return true;
}

const fitting = newestOnly();
let running: AbortController | null = null;

/** Fits that image with the model that is chosen; whatever was asked for before is not wanted any more. */
function fit(file: File | null) {
  running?.abort();
  running = new AbortController();
  const isNewest = fitting();
  batch(() => {
    image.value = file;
    model.value ||= session.value?.active_model ?? "spot";
    answer.value = null;
    fault.value = "";
    isWorking.value = file !== null;
  });
  if (file) void ask(file, model.value, isNewest, running.signal);
}

async function ask(file: File, name: string, isNewest: () => boolean, signal: AbortSignal) {
  try {
    const [found, document] = await Promise.all([
      sendImage<{ items: Estimate[] }>(`/v1/models/${segment(name)}:fit`, file, signal),
      get<ModelDocument>(`/v1/models/${segment(name)}`, signal),
    ]);
    if (isNewest()) answer.value = { estimates: found.items, document };
  } catch (error) {
    if (isNewest()) fault.value = said(error);
  }
  if (isNewest()) isWorking.value = false;
}

/** The outline dᵀ A d = 1 of the role `shape`, where there is one. */
function outline(context: CanvasRenderingContext2D, estimate: Estimate, document: ModelDocument, width: number) {
  const [bx, by] = centreOf(document).map((name) => estimate.parameters[name]);
  if (bx === undefined || by === undefined) return;
  const shape = document.roles?.["shape"];
  const [a1, a2, a3] = Array.isArray(shape) ? shape.map((name: string) => estimate.parameters[name] ?? NaN) : [];
  context.lineWidth = width;
  context.strokeStyle = CONTOUR;
  if (a1 !== undefined && a2 !== undefined && a3 !== undefined) {
    context.beginPath();
    for (let i = 0; i <= 96; i++) {
      const [x, y] = [Math.cos(i * Math.PI / 48), Math.sin(i * Math.PI / 48)];
      const radius = 1 / Math.sqrt(a1 * x * x + 2 * a2 * x * y + a3 * y * y);
      context.lineTo(bx + 0.5 + radius * x, by + 0.5 + radius * y);
    }
    context.stroke();
  }
  context.strokeStyle = CENTRE;
  const arm = 5 * width;
  context.beginPath();
  context.moveTo(bx + 0.5 - arm, by + 0.5);
  context.lineTo(bx + 0.5 + arm, by + 0.5);
  context.moveTo(bx + 0.5, by + 0.5 - arm);
  context.lineTo(bx + 0.5, by + 0.5 + arm);
  context.stroke();
}

export function ImageFit() {
  const canvas = useRef<HTMLCanvasElement>(null);
  const file = image.value;
  const found = answer.value;
  useEffect(() => {
    if (!file) return;
    let isWanted = true;
    void createImageBitmap(file).then((bitmap) => {
      const element = canvas.current;
      if (!element || !isWanted) return;
      element.width = bitmap.width;
      element.height = bitmap.height;
      const context = element.getContext("2d")!;
      context.drawImage(bitmap, 0, 0);
      const seen = found?.estimates.filter((one) => one.state === "tracking") ?? [];
      for (const one of seen) outline(context, one, found!.document, Math.max(1, bitmap.width / 320));
    }, () => { if (isWanted) fault.value = "The browser cannot read that image."; });
    return () => { isWanted = false; };
  }, [file, found]);
  const first = found?.estimates[0];
  return (
    <section class="panel" aria-label="one image">
      <h3>Your own image <small class="quiet">drop it anywhere on the page; PNG or JPEG, or a folder of them</small></h3>
      <p class="row">
        <label class="button">Choose … <input class="hidden-file" type="file" multiple accept="image/png,image/jpeg" onChange={(event) => take(event.currentTarget.files ?? [])} /></label>
        <label>model <select value={model.value || session.value?.active_model} onChange={(event) => { model.value = event.currentTarget.value; fit(image.value); }}>
          {models.value.map((one) => <option key={one.name}>{one.name}</option>)}
        </select></label>
        {others.value.length > 1 && <label>image <select value={file?.name} onChange={(event) => { fit(others.value.find((one) => one.name === event.currentTarget.value) ?? null); }}>
          {others.value.map((one) => <option key={one.name}>{one.name}</option>)}
        </select></label>}
        {isWorking.value && <span class="quiet">fitting …</span>}
      </p>
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
      {file && <canvas ref={canvas} class="image" role="img" aria-label={`${file.name} with what was fitted`} />}
      {first && (
        <>
          <p class="row"><b>{first.state === "tracking" ? "found" : "not found"}</b>
            <span class="quiet">{first.ending}{first.confidence === undefined ? "" : ` · confidence ${(100 * first.confidence).toFixed(1)} %`}{first.rejection ? ` · ${first.rejection}` : ""}</span></p>
          {first.state === "tracking" && <table class="parameters"><tbody>
            {Object.entries(first.parameters).map(([name, value]) => {
              const sigma = sigmaOf(first, name);
              const [shown, deviation] = sigma === undefined ? [plain(value), "held"] : withSigma(value, sigma);
              return <tr key={name}><th scope="row">{name}</th><td class="number">{shown}</td><td class="number">{sigma === undefined ? deviation : `± ${deviation}`}</td><td>{found?.document.parameters[name]?.unit}</td></tr>;
            })}
          </tbody></table>}
        </>
      )}
    </section>
  );
}
