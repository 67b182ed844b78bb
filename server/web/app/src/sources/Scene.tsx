// The synthetic camera: what moves, shines and hides before it, so that one can break the tracker and see how it says so. Sliders
// show the service's scene, which others change as well: each change is made to the scene as it is then, and to nothing else in it.
import { useSignal } from "@preact/signals";
import { Refused, getTagged, segment, send } from "../state/api";
import { learn } from "../state/store";
import type { Source } from "../types";
import { ExposureAdvice } from "./Camera";
import { useSender } from "./sender";
import { Slider } from "./Slider";

type Numbers = number | string;
interface Light { defocus_px?: Numbers; glare?: { height: Numbers; [key: string]: unknown }[]; occluders?: Record<string, unknown>[]; slope?: [Numbers, Numbers] }
interface Scene { exposure?: Numbers; read_noise_e?: number; full_well_e?: number; light?: Light; motion?: Record<string, string> }

/** What the sliders set. */
interface Settings { exposure: number; noise: number; fewer: number; glare: number; slope: number; defocus: number; covered: boolean; amplitude: number; speed: number }

/** Electrons at saturation for a signal-to-noise ratio of a bright pixel: what people mean by noise. */
const FULL_WELL_E = 5000;
const AS_IT_WAS: Settings = { exposure: 1, noise: 15, fewer: 1, glare: 0, slope: 0, defocus: 0, covered: false, amplitude: 110, speed: 0.2 };
/** Others that write at the same moment are faster so often at most. */
const TRIES = 5;

/** A setting may be a formula of somebody's own. */
function numberOr(value: unknown, otherwise: number): number {
  return typeof value === "number" ? value : otherwise;
}

const WAVE = /^\s*(-?[\d.]+)\s*\+\s*([\d.]+)\s*\*\s*(?:sin|cos)\(2\*pi\*([\d.]+)\*t\)\s*$/;

/** Centre, amplitude and frequency of a movement as the sliders write it. */
function wave(formula: string | undefined): [number, number, number] | undefined {
  const found = WAVE.exec(formula ?? "");
  return found ? [Number(found[1]), Number(found[2]), Number(found[3])] : undefined;
}

function isCover(occluder: Record<string, unknown>): boolean {
  return Object.keys(occluder).every((key) => key === "value");
}

function settingsOf({ exposure, read_noise_e, full_well_e, light, motion }: Scene): Settings {
  const [, amplitude, speed] = wave(motion?.["bx"]) ?? [0, AS_IT_WAS.amplitude, AS_IT_WAS.speed];
  return {
    exposure: numberOr(exposure, 1),
    noise: read_noise_e ?? 0,
    fewer: full_well_e ? FULL_WELL_E / full_well_e : 1,
    glare: numberOr(light?.glare?.[0]?.height, 0),
    slope: numberOr(light?.slope?.[0], 0),
    defocus: numberOr(light?.defocus_px, 0),
    covered: light?.occluders?.some(isCover) ?? false,
    amplitude, speed,
  };
}

/** What is to be put for these settings, beside everything else that is in the scene. */
function changed(scene: Scene, set: Partial<Settings>, width: number, height: number): Scene {
  const next: Scene = {};
  if (set.exposure !== undefined) next.exposure = Number(set.exposure.toPrecision(3));
  if (set.noise !== undefined) next.read_noise_e = set.noise;
  if (set.fewer !== undefined) next.full_well_e = FULL_WELL_E / set.fewer;
  const light = { ...scene.light };
  if (set.glare !== undefined) {
    const [first, ...others] = light.glare ?? [];
    const lobe = { x: width * 0.62, y: height * 0.45, sigma_px: width / 18, ...first, height: set.glare };
    light.glare = set.glare > 0 ? [lobe, ...others] : others;
  }
  if (set.slope !== undefined) light.slope = [set.slope, light.slope?.[1] ?? 0];
  if (set.defocus !== undefined) light.defocus_px = set.defocus;
  if (set.covered !== undefined) light.occluders = [...(light.occluders ?? []).filter((one) => !isCover(one)), ...(set.covered ? [{ value: 0 }] : [])];
  if (["glare", "slope", "defocus", "covered"].some((key) => key in set)) next.light = light;
  const across = wave(scene.motion?.["bx"]);
  if (across && (set.amplitude !== undefined || set.speed !== undefined)) {
    const [amplitude, speed] = [set.amplitude ?? across[1], set.speed ?? across[2]];
    next.motion = { ...scene.motion, bx: `${across[0]} + ${amplitude}*sin(2*pi*${speed}*t)` };
    const down = wave(scene.motion?.["by"]);
    if (down) next.motion["by"] = `${down[0]} + ${Math.round(amplitude * 0.64)}*cos(2*pi*${(speed * 0.65).toFixed(3)}*t)`;
  }
  return next;
}

export function ScenePanel({ source }: { source: Source }) {
  const fault = useSignal("");
  /** Set here, and not in the service's answer yet. */
  const pending = useSignal<Partial<Settings>>({});
  const scene = source as Scene;
  const [width, height] = [numberOr(source["width"], 640), numberOr(source["height"], 480)];
  const path = `/v1/sources/${segment(source.name)}/scene`;
  const put = async (set: Partial<Settings>) => {
    for (let left = TRIES; ; left--) {
      const { value, tag } = await getTagged<Scene>(path);
      try {
        const view = await send<Record<string, unknown>>("PUT", path, changed(value, set, width, height), tag);
        return learn(source.name, view ?? {});
      } catch (error) {
        if (!(error instanceof Refused && error.status === 412 && left > 0)) throw error;
      }
    }
  };
  const send_ = useSender<Partial<Settings>>(put, fault);
  const change = async (set: Partial<Settings>) => {
    pending.value = { ...pending.peek(), ...set };
    if (await send_(set)) pending.value = {};
  };
  const now = { ...settingsOf(scene), ...pending.value };
  const moves = wave(scene.motion?.["bx"]) !== undefined;
  return (
    <section class="panel scene" aria-label="scene">
      <h3>{source.name} <small class="quiet">a synthetic camera: make it hard to follow</small></h3>
      <Slider label="exposure" unit="×" value={Math.log2(now.exposure)} min={-5} max={3} step={0.1} shown={now.exposure.toPrecision(2)}
        set={(to) => void change({ exposure: 2 ** to })} />
      <Slider label="read noise" unit="e⁻" value={now.noise} min={0} max={400} step={5} set={(noise) => void change({ noise })} />
      <Slider label="photon noise" unit="× fewer e⁻" value={Math.log2(now.fewer)} min={0} max={7} step={0.1} shown={now.fewer.toPrecision(2)}
        set={(to) => void change({ fewer: 2 ** to })} />
      <Slider label="glare" unit="DN" value={now.glare} min={0} max={250} step={5} set={(glare) => void change({ glare })} />
      <Slider label="slope of the light" unit="DN/px" value={now.slope} min={0} max={0.4} step={0.01} set={(slope) => void change({ slope })} />
      <Slider label="defocus" unit="px" value={now.defocus} min={0} max={12} step={0.5} set={(defocus) => void change({ defocus })} />
      {moves && (
        <>
          <Slider label="movement" unit="px" value={now.amplitude} min={0} max={Math.round(height / 2)} step={5} set={(amplitude) => void change({ amplitude })} />
          <Slider label="speed" unit="turns/s" value={now.speed} min={0} max={2} step={0.05} set={(speed) => void change({ speed })} />
        </>
      )}
      <ExposureAdvice />
      <p class="row">
        <label><input type="checkbox" checked={now.covered} onChange={(event) => void change({ covered: event.currentTarget.checked })} /> cover the lens</label>
        <button onClick={() => void change(AS_IT_WAS)}>Reset</button>
      </p>
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
    </section>
  );
}
