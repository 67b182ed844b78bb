// Curves over time or place, with bands: uPlot with the page's colours.
import uPlot from "uplot";
import { themed } from "./colour";

export interface Curve { label: string; colour: string; width?: number; dash?: number[]; points?: boolean; bars?: boolean }

export interface ChartLook {
  curves: Curve[];
  /** Pairs of curves (counted from 1) between which the ground is filled. */
  bands?: { between: [number, number]; colour: string }[];
  across: string;
  /** A label, or what says it at each drawing; none where it is empty at first. */
  along: string | (() => string);
  /** Formats along's ticks; numbers when absent. */
  ticks?: (value: number) => string;
  /** A height that the vertical axis reaches at least. */
  least?: number;
  log?: boolean;
}

function axis(label: string | (() => string), values?: (value: number) => string): uPlot.Axis {
  return {
    label, labelSize: 18, labelFont: "12px system-ui, sans-serif", font: "11px system-ui, sans-serif", labelGap: 0,
    stroke: () => themed("quiet"), grid: { stroke: () => themed("rule"), width: 1 }, ticks: { show: false },
    ...(values ? { values: (_: uPlot, splits: number[]) => splits.map(values) } : {}),
  };
}

export function chart(holder: HTMLElement, look: ChartLook): uPlot {
  const size = () => ({ width: holder.clientWidth, height: holder.clientHeight });
  const series: uPlot.Series[] = [{}];
  for (const curve of look.curves) {
    series.push({
      label: curve.label, stroke: () => themed(curve.colour), width: curve.width ?? 1.5, dash: curve.dash,
      points: { show: curve.points ?? false, size: 4, fill: () => themed(curve.colour) },
      ...(curve.points ? { paths: () => null } : {}),
      ...(curve.bars ? { paths: uPlot.paths.bars!({ size: [0.9] }), fill: () => themed(curve.colour) } : {}),
    });
  }
  const made = new uPlot(
    {
      ...size(), series, legend: { show: false }, cursor: { drag: { x: false, y: false }, points: { show: false } },
      scales: { x: { time: false }, y: { range: (_, low, high) => ranged(low, high, look.least) } },
      bands: (look.bands ?? []).map(({ between, colour }) => ({ series: between, fill: () => themed(colour) })),
      axes: [{ ...axis(look.across, look.ticks), size: 26 }, { ...axis(look.along), size: 50, space: 26, ...(look.along ? {} : { label: undefined }) }],
      padding: [8, 8, 0, 0],
    },
    [[], ...look.curves.map(() => [])] as unknown as uPlot.AlignedData,
    holder,
  );
  const resized = new ResizeObserver(() => { if (holder.clientWidth > 0) made.setSize(size()); });
  resized.observe(holder);
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  const redraw = () => made.redraw();
  scheme.addEventListener("change", redraw);
  const destroy = made.destroy.bind(made);
  made.destroy = () => { resized.disconnect(); scheme.removeEventListener("change", redraw); destroy(); };
  return made;
}

function ranged(low: number | null, high: number | null, least = 0): uPlot.Range.MinMax {
  if (low === null || high === null) return [0, 1];
  const [from, to] = [low, Math.max(high, least)];
  const room = Math.max((to - from) * 0.08, Math.abs(to) * 1e-9, 1e-12);
  return [from - room, to + room];
}
