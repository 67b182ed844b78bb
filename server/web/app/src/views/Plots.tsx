// Parameters over time with their ±σ bands, what else changes, and how long it takes. Space pauses; then one can scroll back.
import { computed, useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import type uPlot from "uplot";
import { chart, type ChartLook } from "../draw/chart";
import { sigmaOf } from "../draw/ellipse";
import { modelName, powerOfTen } from "../format";
import { Trace } from "../parts/Trace";
import { pause } from "../state/pictures";
import { beat, document_, hasPlace, history, newest, paused, session, timeOf } from "../state/store";
import type { Estimate } from "../types";

const SPANS_S = [5, 20, 60, 180];
/** The free parameters, as one word that changes with them alone. */
const orderShown = computed(() => newest.value?.order.join(" ") ?? "");
/** Charts are drawn anew every so many beats: three times a second. */
const BEATS = 2;
const POINTS_MAX = 900;

export function Plots() {
  const span = useSignal(20);
  const back = useSignal(0);
  const order = orderShown.value ? orderShown.value.split(" ") : [];
  const total = history.length;
  return (
    <div class="plots">
      <p class="row bar">
        <button class={paused.value ? "primary" : ""} onClick={() => { pause(); back.value = 0; }}>{paused.value ? "Go on" : "Pause"}</button>
        <label>last <select value={span} onChange={(event) => { span.value = Number(event.currentTarget.value); }}>
          {SPANS_S.map((seconds) => <option key={seconds} value={seconds}>{seconds} s</option>)}
        </select></label>
        <label class="grow">back <input type="range" min={0} max={Math.max(1, total - 10)} value={back} disabled={!paused.value}
          onInput={(event) => { back.value = Number(event.currentTarget.value); }} aria-label="scroll back" /></label>
        <button onClick={exportCsv}>CSV</button>
        <span class="quiet">{paused.value ? "paused: scroll back with the slider" : "space pauses"}</span>
      </p>
      <div class="charts" key={order.join()}>
        {order.map((name) => [name, document_.value?.parameters[name]?.unit ?? ""] as const).map(([name, unit]) => <Chart key={`${name} ${unit}`} title={name} unit={unit} span={span.value} back={back.value} series={(e) => [e.parameters[name], sigmaOf(e, name)]} />)}
        <Chart title="χ²/ν" unit="" span={span.value} back={back.value} series={(e) => [e.reduced_chi_square]} />
        <Chart title="objective F" unit="" span={span.value} back={back.value} series={(e) => [e.objective]} />
        <Chart title="background" unit="DN" span={span.value} back={back.value} series={(e) => [e.illumination?.background]} />
        <Chart title="brightness" unit="DN" span={span.value} back={back.value} series={(e) => [e.illumination?.brightness]} />
        <Chart title="exposure advised" unit="× as much light" span={span.value} back={back.value} series={(e) => [e.exposure_advice?.factor]} />
        <Chart title="confidence" unit="" span={span.value} back={back.value} series={(e) => [e.confidence]} />
        <Trace />
        <Latency span={span.value} back={back.value} />
      </div>
    </div>
  );
}

/** The estimates of so many seconds, `back` estimates ago, thinned to what a chart can show. */
function part(span: number, back: number): Estimate[] {
  const end = history.length - (paused.peek() ? back : 0);
  const last = history[end - 1];
  if (!last) return [];
  let start = end;
  while (start > 0 && timeOf(last) - timeOf(history[start - 1]!) <= span) start -= 1;
  const every = Math.ceil((end - start) / POINTS_MAX);
  return history.slice(start, end).filter((_, i) => i % every === 0);
}

interface ChartProps {
  title: string;
  unit: string;
  span: number;
  back: number;
  series: (estimate: Estimate) => (number | undefined)[];
}

function useChart(look: ChartLook, draw: (made: uPlot) => void, watched: unknown[]) {
  const holder = useRef<HTMLDivElement>(null);
  const made = useRef<uPlot | null>(null);
  useEffect(() => {
    made.current = chart(holder.current!, look);
    let beats = 0;
    const stop = beat.subscribe(() => {
      if (!paused.peek() && beats++ % BEATS === 0) draw(made.current!);
    });
    return () => { stop(); made.current?.destroy(); };
  }, []);
  useEffect(() => { if (made.current) draw(made.current); }, watched);
  return holder;
}

function Chart({ title, unit, span, back, series }: ChartProps) {
  const settings = useRef({ span, back });
  settings.current = { span, back };
  const isEmpty = useSignal(false);
  const power = useSignal(0);
  const look: ChartLook = {
    across: "seconds", along: unit ? () => `${powerOfTen(power.value)} ${unit}`.trim() : "",
    curves: [
      { label: "−σ", colour: "band-edge", width: 0 }, { label: "+σ", colour: "band-edge", width: 0 },
      { label: title, colour: "accent" },
    ],
    bands: [{ between: [2, 1], colour: "band-blue" }],
  };
  const draw = (made: uPlot) => {
    const seen = part(settings.current.span, settings.current.back);
    const end = seen.length ? timeOf(seen[seen.length - 1]!) : 0;
    const [times, low, high, values]: [number[], (number | null)[], (number | null)[], (number | null)[]] = [[], [], [], []];
    for (const estimate of seen) {
      const [value, sigma] = hasPlace(estimate) ? series(estimate) : []; // a gap while the target is lost
      times.push(timeOf(estimate) - end);
      values.push(value ?? null);
      low.push(value === undefined || sigma === undefined ? null : value - sigma);
      high.push(value === undefined || sigma === undefined ? null : value + sigma);
    }
    isEmpty.value = values.every((value) => value === null);
    const most = values.reduce<number>((most, value) => Math.max(most, Math.abs(value ?? 0)), 0);
    power.value = most > 0 && (most < 1e-2 || most >= 1e5) ? Math.floor(Math.log10(most) / 3) * 3 : 0;
    const scale = 10 ** -power.value;
    for (const row of [low, high, values]) row.forEach((value, i) => { if (value !== null) row[i] = value * scale; });
    made.setData([times, low, high, values] as uPlot.AlignedData);
  };
  const holder = useChart(look, draw, [span, back, paused.value]);
  return (
    <figure class="panel" hidden={isEmpty.value}>
      <figcaption>{title} {!unit && <small class="quiet">{powerOfTen(power.value)}</small>}</figcaption>
      <div ref={holder} class="chart" />
    </figure>
  );
}

const BINS = 40;

function Latency({ span, back }: { span: number; back: number }) {
  const settings = useRef({ span, back });
  settings.current = { span, back };
  const words = useSignal("");
  const look: ChartLook = {
    across: "ms from capture to estimate", along: "frames", least: 1,
    curves: [{ label: "frames", colour: "accent", bars: true }],
  };
  const draw = (made: uPlot) => {
    const seen = part(settings.current.span, settings.current.back);
    const ages = seen.flatMap((e) => (e.publish_ns && e.capture_ns ? [(e.publish_ns - e.capture_ns) / 1e6] : [])).sort((a, b) => a - b);
    if (ages.length === 0) return;
    const most = Math.max(0.1, ages[Math.floor(0.99 * (ages.length - 1))]! * 1.15);
    const counts = new Array<number>(BINS).fill(0);
    for (const age of ages) counts[Math.min(BINS - 1, Math.floor(age / most * BINS))]! += 1;
    const at = (share: number) => ages[Math.floor(share * (ages.length - 1))]!.toFixed(1);
    words.value = `median ${at(0.5)} ms · 99 % within ${at(0.99)} ms`;
    made.setData([counts.map((_, i) => (i + 0.5) * most / BINS), counts]);
  };
  const holder = useChart(look, draw, [span, back, paused.value]);
  return (
    <figure class="panel">
      <figcaption>Latency <small class="quiet">{words}</small></figcaption>
      <div ref={holder} class="chart" />
    </figure>
  );
}

/** All estimates that are kept, one a line, to a file. */
function exportCsv() {
  const names = Object.keys(history[history.length - 1]?.parameters ?? {});
  const head = ["frame", "time_s", "state", "model", ...names, ...names.map((name) => `sigma_${name}`), "objective", "reduced_chi_square", "confidence", "fit_us"];
  const cell = (value: unknown) => (value === undefined ? "" : String(value));
  const rows = history.map((e) => [
    e.frame, e.time_s, e.state, modelName(e.model),
    ...(hasPlace(e) ? [...names.map((name) => e.parameters[name]), ...names.map((name) => sigmaOf(e, name)), e.objective, e.reduced_chi_square, e.confidence]
      : Array<undefined>(2 * names.length + 3).fill(undefined)),
    e.timing_us?.fit,
  ].map(cell).join(","));
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([[head.join(","), ...rows].join("\n") + "\n"], { type: "text/csv" }));
  link.download = `${session.peek()?.name ?? "estimates"}.csv`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
