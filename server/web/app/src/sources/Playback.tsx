// A recording, or a synthetic camera: pause, step, scrub, speed, loop. Frame numbers of estimates only grow.
import { useSignal } from "@preact/signals";
import { get, said, segment, send } from "../state/api";
import { learn } from "../state/store";
import type { Source } from "../types";
import { Slider } from "./Slider";

interface View { paused: boolean; frame?: number; length?: number; speed: number; loop?: boolean }

export function PlaybackPanel({ source }: { source: Source }) {
  const fault = useSignal("");
  const now = source["playback"] as View | undefined;
  if (!now) return null;
  const path = `/v1/sources/${segment(source.name)}/playback`;
  const change = async (wanted: () => Promise<Record<string, unknown>>) => {
    try {
      const playback = await send<View>("PUT", path, await wanted());
      learn(source.name, { playback, position: playback?.frame });
      fault.value = "";
    } catch (error) {
      fault.value = said(error);
    }
  };
  const put = (document: Record<string, unknown>) => change(async () => document);
  // The service takes absolute frames: a request that is sent again steps once.
  const step = (by: number) => change(async () => {
    const at = await get<View>(path);
    const to = (at.frame ?? -1) + by;
    return { frame: at.loop && at.length ? (to + at.length) % at.length : Math.max(0, to) };
  });
  const position = (source["position"] as number | undefined) ?? now.frame ?? 0;
  const isRecording = source.kind === "recording";
  return (
    <section class="panel" aria-label="playback">
      <h3>Playback <small class="quiet">{source.name}{isRecording && now.length ? ` · frame ${position + 1} of ${now.length}` : ""}</small></h3>
      <p class="row">
        <button class={now.paused ? "primary" : ""} onClick={() => void put({ paused: !now.paused })}>{now.paused ? "Play" : "Hold"}</button>
        {isRecording && <button disabled={!now.paused} aria-label="a frame back" onClick={() => void step(-1)}>◂ step</button>}
        <button disabled={!now.paused} aria-label="a frame on" onClick={() => void step(1)}>step ▸</button>
        {isRecording && <label><input type="checkbox" checked={now.loop ?? false} onChange={(event) => void put({ loop: event.currentTarget.checked })} /> loop</label>}
      </p>
      {isRecording && now.length !== undefined && (
        <Slider label="frame" unit="" value={position} min={0} max={Math.max(0, now.length - 1)} step={1} set={(to) => void put({ frame: to })} />
      )}
      <Slider label="pace" unit="×" value={Math.log2(now.speed)} min={-4} max={4} step={0.5} shown={now.speed.toPrecision(2)}
        set={(to) => void put({ speed: Number((2 ** to).toPrecision(3)) })} />
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
    </section>
  );
}
