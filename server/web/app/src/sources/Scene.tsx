// The synthetic camera: what moves, shines and hides before it, so that one can break the tracker and see how it says so. Each
// slider is taken between two frames.
import { useSignal } from "@preact/signals";
import { segment, send } from "../state/api";
import type { Source } from "../types";
import { ExposureAdvice } from "./Camera";
import { useSender } from "./sender";
import { Slider } from "./Slider";

interface Light { defocus_px?: unknown; glare?: { height?: unknown }[]; occluders?: unknown[]; slope?: unknown[] }

function numberOr(value: unknown, otherwise: number): number {
  return typeof value === "number" ? value : otherwise;
}

/** Electrons at saturation for a signal-to-noise ratio of a bright pixel: what people mean by noise. */
const FULL_WELL_E = 5000;

export function ScenePanel({ source }: { source: Source }) {
  const fault = useSignal("");
  const change = useSender(async (scene) => { await send("PUT", `/v1/sources/${segment(source.name)}/scene`, scene); }, fault);
  const light = (source["light"] ?? {}) as Light;
  const [width, height] = [numberOr(source["width"], 640), numberOr(source["height"], 480)];
  const exposure = useSignal(numberOr(source["exposure"], 1));
  const noise = useSignal(numberOr(source["read_noise_e"], 15));
  const fewer = useSignal(FULL_WELL_E / Math.max(1, numberOr(source["full_well_e"], FULL_WELL_E)));
  const glare = useSignal(numberOr(light.glare?.[0]?.height, 0));
  const defocus = useSignal(numberOr(light.defocus_px, 0));
  const slope = useSignal(numberOr(light.slope?.[0], 0));
  const isCovered = useSignal(Boolean(light.occluders?.length));
  const amplitude = useSignal(110);
  const speed = useSignal(0.2);

  const sendLight = () => change({
    light: {
      ...(defocus.value > 0 ? { defocus_px: defocus.value } : {}),
      ...(slope.value > 0 ? { slope: [slope.value, 0] } : {}),
      ...(glare.value > 0 ? { glare: [{ x: width * 0.62, y: height * 0.45, sigma_px: width / 18, height: glare.value }] } : {}),
      ...(isCovered.value ? { occluders: [{ value: 0 }] } : {}),
    },
  });
  const sendMotion = () => change({
    motion: {
      ...(source["motion"] as Record<string, string> | undefined),
      bx: `${width / 2} + ${amplitude.value}*sin(2*pi*${speed.value}*t)`,
      by: `${height / 2} + ${Math.round(amplitude.value * 0.64)}*cos(2*pi*${(speed.value * 0.65).toFixed(3)}*t)`,
    },
  });
  const moves = "bx" in ((source["motion"] as object | undefined) ?? {});
  const reset = () => {
    [exposure.value, noise.value, fewer.value, glare.value, defocus.value, slope.value, amplitude.value, speed.value] = [1, 15, 1, 0, 0, 0, 110, 0.2];
    isCovered.value = false;
    void change({ exposure: 1, read_noise_e: 15, full_well_e: FULL_WELL_E });
    void sendLight();
    if (moves) void sendMotion();
  };
  return (
    <section class="panel scene" aria-label="scene">
      <h3>{source.name} <small class="quiet">a synthetic camera: make it hard to follow</small></h3>
      <Slider label="exposure" unit="×" value={Math.log2(exposure.value)} min={-5} max={3} step={0.1} shown={exposure.value.toPrecision(2)}
        set={(to) => { exposure.value = 2 ** to; void change({ exposure: Number((2 ** to).toPrecision(3)) }); }} />
      <Slider label="read noise" unit="e⁻" value={noise.value} min={0} max={400} step={5} set={(to) => { noise.value = to; void change({ read_noise_e: to }); }} />
      <Slider label="photon noise" unit="× fewer e⁻" value={Math.log2(fewer.value)} min={0} max={7} step={0.1} shown={fewer.value.toPrecision(2)}
        set={(to) => { fewer.value = 2 ** to; void change({ full_well_e: FULL_WELL_E / 2 ** to }); }} />
      <Slider label="glare" unit="DN" value={glare.value} min={0} max={250} step={5} set={(to) => { glare.value = to; void sendLight(); }} />
      <Slider label="slope of the light" unit="DN/px" value={slope.value} min={0} max={0.4} step={0.01} set={(to) => { slope.value = to; void sendLight(); }} />
      <Slider label="defocus" unit="px" value={defocus.value} min={0} max={12} step={0.5} set={(to) => { defocus.value = to; void sendLight(); }} />
      {moves && (
        <>
          <Slider label="movement" unit="px" value={amplitude.value} min={0} max={Math.round(height / 2)} step={5} set={(to) => { amplitude.value = to; void sendMotion(); }} />
          <Slider label="speed" unit="turns/s" value={speed.value} min={0} max={2} step={0.05} set={(to) => { speed.value = to; void sendMotion(); }} />
        </>
      )}
      <ExposureAdvice />
      <p class="row">
        <label><input type="checkbox" checked={isCovered} onChange={(event) => { isCovered.value = event.currentTarget.checked; void sendLight(); }} /> cover the lens</label>
        <button onClick={reset}>As it was</button>
      </p>
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
    </section>
  );
}
