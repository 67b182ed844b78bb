// The cross-section through the centre: what was measured, what the model says, ± σ of a pixel, and where the camera clips.
import type { ReadonlySignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import type uPlot from "uplot";
import { chart } from "../draw/chart";
import type { ShownHead } from "../picture/messages";

export function Section({ head }: { head: ReadonlySignal<ShownHead | null> }) {
  const holder = useRef<HTMLDivElement>(null);
  const title = useRef<HTMLElement>(null);
  useEffect(() => {
    const made: uPlot = chart(holder.current!, {
      across: "x in px", along: "DN",
      curves: [
        { label: "model − σ", colour: "band-edge", width: 0 },
        { label: "model + σ", colour: "band-edge", width: 0 },
        { label: "measured", colour: "ink", points: true },
        { label: "model", colour: "contour", width: 2 },
        { label: "the camera's limit", colour: "clip", dash: [6, 4] },
      ],
      bands: [{ between: [2, 1], colour: "band" }],
    });
    const stop = head.subscribe((now) => {
      const section = now?.section;
      if (!section) {
        if (now) made.setData([[], [], [], [], [], []]);
        if (now && title.current) title.current.textContent = "no target, no centre";
        return;
      }
      const model = section.model ?? section.x.map(() => null);
      const edge = (sign: number) => model.map((value, i) => (value === null ? null : value + sign * (section.sigma?.[i] ?? 0)));
      const most = Math.max(...section.observed);
      const limit = section.saturation;
      const clip = section.x.map(() => (limit !== undefined && most > 0.8 * limit ? limit : null));
      made.setData([section.x, edge(-1), edge(1), section.observed, model, clip] as uPlot.AlignedData);
      if (title.current) title.current.textContent = `row y = ${Math.round(section.y)} through the centre`;
    });
    return () => { stop(); made.destroy(); };
  }, []);
  return (
    <figure class="section">
      <figcaption>Cross-section <small ref={title} class="quiet">through the centre</small>
        <span class="key">
          <span><i class="dot" /> measured</span><span><i class="line" /> model</span><span><i class="block" /> ± σ of a pixel</span>
          <span><i class="line clip" /> camera's limit</span>
        </span>
      </figcaption>
      <div ref={holder} class="chart tall" />
    </figure>
  );
}
