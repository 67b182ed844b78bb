// Cameras of the service's machine: formats, controls with the driver's ranges, and the exposure that fits advise.
import { signal, useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { plain } from "../format";
import { get, getTagged, newestOnly, said, segment, send } from "../state/api";
import { beat, newest, refresh, session } from "../state/store";
import type { Session } from "../types";
import { useSender } from "./sender";
import { Slider } from "./Slider";

/** Each look asks the driver for all its controls. */
const POLL_MS = 2000;

interface Control { name: string; kind: "integer" | "boolean" | "menu" | "integer_menu" | "button"; minimum: number; maximum: number; step: number; value?: number; items?: Record<string, string>; is_inactive?: boolean }
interface Size { width: number; height: number; from?: [number, number]; rates_hz: number[] }
interface Camera { device: string; identity: string; name: string; formats: { format: string; is_read: boolean; sizes: Size[] }[]; controls: Control[] }

export function CameraPanel({ device }: { device: string }) {
  const camera = useSignal<Camera | null>(null);
  const fault = useSignal("");
  const path = `/v1/cameras/${segment(device)}`;
  const reading = useRef(newestOnly());
  const read = async () => {
    const isNewest = reading.current();
    const found = await get<Camera>(path);
    if (isNewest()) camera.value = found;
  };
  // Others set it, too. A driver that takes its time is asked again after its answer only.
  useEffect(() => {
    let isShown = true;
    const follow = async () => {
      while (isShown) {
        if (!document.hidden) await read().catch((error) => { fault.value = said(error); });
        await new Promise((done) => setTimeout(done, POLL_MS));
      }
    };
    void follow();
    return () => { isShown = false; };
  }, [device]);
  const put = useSender<Record<string, number | boolean>>(async (controls) => {
    try {
      await send("PUT", `${path}/controls`, controls);
    } finally {
      await read(); // drivers clamp without a word, and one control switches another off
    }
  }, fault);
  const set = (name: string, value: number | boolean) => {
    reading.current(); // a look that is under way is older
    const before = camera.value;
    if (before) camera.value = { ...before, controls: before.controls.map((one) => (one.name === name ? { ...one, value: Number(value) } : one)) };
    void put({ [name]: value });
  };
  return (
    <section class="panel" aria-label="camera">
      <h3>{camera.value?.name ?? device} <small class="quiet">{device}</small></h3>
      <ExposureAdvice />
      {camera.value?.controls.map((control) => <ControlRow key={control.name} control={control} set={(value) => set(control.name, value)} />)}
      {camera.value && <Formats camera={camera.value} />}
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
    </section>
  );
}

/** As drivers of USB cameras have them. */
const UNITS: Record<string, string> = { exposure_time_absolute: "× 100 µs", exposure_absolute: "× 100 µs", white_balance_temperature: "K" };

/** What it can send. */
function Formats({ camera }: { camera: Camera }) {
  return (
    <div class="scroll"><table>
      <thead><tr><th>format</th><th>size in px</th><th>frames a second</th></tr></thead>
      <tbody>
        {camera.formats.filter((one) => one.is_read).flatMap(({ format, sizes }) => sizes.map(({ width, height, from, rates_hz }) => (
          <tr key={`${format} ${width} ${height}`}>
            <th scope="row">{format}</th><td>{from ? `${from.join(" × ")} to ` : ""}{width} × {height}</td><td>{rates_hz.map((rate) => plain(rate, 3)).join(", ")}</td>
          </tr>
        )))}
      </tbody>
    </table></div>
  );
}

function ControlRow({ control, set }: { control: Control; set(value: number | boolean): void }) {
  const { name, kind, minimum, maximum, step, value, items, is_inactive } = control;
  const label = name.replace(/_/g, " ");
  const why = is_inactive ? "an automatic control stands in its way; setting it switches that off" : "";
  if (kind === "boolean") {
    return <p><label title={why}><input type="checkbox" checked={value === 1} onChange={(event) => set(event.currentTarget.checked)} /> {label}</label></p>;
  }
  if (kind === "menu" || kind === "integer_menu") {
    return (
      <p><label title={why}>{label} <select value={String(value)} onChange={(event) => set(Number(event.currentTarget.value))}>
        {Object.entries(items ?? {}).map(([number, word]) => <option key={number} value={number}>{word}</option>)}
      </select></label></p>
    );
  }
  if (kind === "button") return <p><button onClick={() => set(1)}>{label}</button></p>;
  return <Slider label={label} unit={is_inactive ? "automatic" : UNITS[name] ?? ""} value={value ?? minimum} min={minimum} max={maximum} step={Math.max(1, step)} set={set} />;
}

const OF_DOCUMENT = ["source", "model", "constants", "start", "window", "camera", "target", "options"];

/** What exposure the fits advise, and whether the session sets it by itself. */
export function ExposureAdvice() {
  const fault = useSignal("");
  const one = session.value;
  void beat.value;
  const advice = newest.peek()?.exposure_advice;
  const isControlled = one?.options?.exposure?.control ?? false;
  const toggle = async (control: boolean) => {
    if (!one) return;
    const path = `/v1/sessions/${segment(one.name)}`;
    try {
      const { value, tag } = await getTagged<Record<string, unknown> & Session>(path);
      const document = Object.fromEntries(OF_DOCUMENT.filter((key) => value[key] !== undefined && value[key] !== null).map((key) => [key, value[key]]));
      document["options"] = { ...value.options, exposure: { ...value.options?.exposure, control } };
      await send("PUT", path, document, tag);
      fault.value = "";
      await refresh();
    } catch (error) {
      fault.value = said(error);
    }
  };
  return (
    <>
      <p class="row">
        <span>Exposure advice: <b>{advice ? `× ${plain(advice.factor, 2)}` : "none yet"}</b> <small class="quiet">{advice?.why}</small></span>
        <label title="starts the session anew"><input type="checkbox" checked={isControlled} onChange={(event) => void toggle(event.currentTarget.checked)} /> Auto exposure</label>
      </p>
      {one?.exposure_control?.held === false && <p class="quiet">Only looking: {one.exposure_control.reason}</p>}
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
    </>
  );
}

/** Those of the service's machine, as they were when somebody last asked. */
export const cameras = signal<Camera[] | null>(null);

export function CameraList() {
  const fault = useSignal("");
  useEffect(() => { get<{ items: Camera[] }>("/v1/cameras").then((found) => { cameras.value = found.items; }, (error) => { fault.value = said(error); }); }, []);
  return (
    <section class="panel">
      <h3>Cameras <small class="quiet">of the service's machine</small></h3>
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
      {cameras.value?.length === 0 && <p class="quiet">None is plugged in.</p>}
      {cameras.value?.map((camera) => (
        <details key={camera.identity}>
          <summary><b>{camera.device}</b> {camera.name} <span class="quiet">{camera.identity}</span></summary>
          <Formats camera={camera} />
          <p class="quiet">{camera.controls.length} controls: start a session of it to set them.</p>
        </details>
      ))}
    </section>
  );
}
