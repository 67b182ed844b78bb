// How the last frame's fit came to its end: F at each point that it tried.
import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import type uPlot from "uplot";
import { chart } from "../draw/chart";
import { protocols, segment } from "../state/api";
import { chosen, paused, target } from "../state/store";
import { stream } from "../state/stream";
import type { Estimate } from "../types";

interface Point { stage: number; pass: number; objective: number; radius?: number; ratio?: number }

/** Fits are told of so often: who wants a trace makes the service keep it. */
const PAUSE_MS = 400;

export function Trace() {
  const holder = useRef<HTMLDivElement>(null);
  const words = useSignal("");
  useEffect(() => {
    const made: uPlot = chart(holder.current!, { across: "point", along: "", curves: [{ label: "F", colour: "contour" }, { label: "points", colour: "contour", points: true }] });
    const name = chosen.value;
    if (!name) return () => made.destroy();
    const path = () => `/v1/sessions/${segment(name)}/estimates?mode=latest&trace=1&credit=1`;
    const estimates = stream(path, protocols(), {
      async message(data) {
        const { trace, frame, target: whose } = JSON.parse(data as string) as Estimate & { trace?: Point[] };
        if (trace?.length && whose === target.peek() && !paused.peek()) {
          const values = trace.map((point) => point.objective);
          made.setData([values.map((_, i) => i), values, values]);
          words.value = `frame ${frame} · ${trace.length} points in ${new Set(trace.map((point) => point.stage)).size} stage(s)`;
        }
        await new Promise((done) => setTimeout(done, PAUSE_MS));
      },
    });
    return () => { estimates.close(); made.destroy(); };
  }, [chosen.value]);
  return (
    <figure class="panel">
      <figcaption>F at each point of the last fit <small class="quiet">{words}</small></figcaption>
      <div ref={holder} class="chart" />
    </figure>
  );
}
