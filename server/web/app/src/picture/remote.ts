// A picture of the session that is looked at, as the page sees it: a canvas that another thread draws on.
import { computed, effect, signal } from "@preact/signals";
import { entered, protocols, segment } from "../state/api";
import { centreOf, chosen, document_, paused, session } from "../state/store";
import { NOTHING_TOLD, type Look, type Order, type Part, type Told } from "./messages";

/** What of the session is shown. */
export interface Subject {
  part: Part;
  /** As its shadow sees it. */
  shadow?: true;
}

export class RemotePicture {
  readonly told = signal<Told>(NOTHING_TOLD);
  private readonly worker = new Worker(new URL("./worker.ts", import.meta.url), { type: "module" });
  private readonly ends: (() => void)[] = [];

  constructor(private readonly canvas: HTMLCanvasElement, { part, shadow }: Subject) {
    this.worker.onmessage = ({ data }: MessageEvent<Told>) => { this.told.value = data; };
    const drawn = canvas.transferControlToOffscreen();
    this.worker.postMessage({ kind: "begin", canvas: drawn, part } satisfies Order, [drawn]);
    const resized = new ResizeObserver(() => this.measure());
    resized.observe(canvas);
    const hidden = () => this.look({ isHidden: document.hidden });
    document.addEventListener("visibilitychange", hidden);
    const rateHz = computed(() => Math.min(30, session.value?.rate_hz || 30));
    this.ends.push(
      () => resized.disconnect(),
      () => document.removeEventListener("visibilitychange", hidden),
      effect(() => this.look({ centre: centreOf(document_.value), rateHz: rateHz.value, isPaused: paused.value })),
      effect(() => {
        void entered.value;
        const query = `part=${part}${shadow ? "&shadow=1" : ""}`;
        const path = chosen.value && `/v1/sessions/${segment(chosen.value)}/preview?${query}`;
        this.order({ kind: "follow", path, protocols: protocols() });
      }),
    );
    hidden();
  }

  private measure() {
    const ratio = window.devicePixelRatio;
    this.look({ width: Math.round(this.canvas.clientWidth * ratio), height: Math.round(this.canvas.clientHeight * ratio), ratio });
  }

  order(order: Order) {
    this.worker.postMessage(order);
  }

  look(look: Partial<Look>) {
    this.order({ kind: "look", look });
  }

  get isZoomed(): boolean {
    return this.told.peek().isZoomed;
  }

  close() {
    this.ends.forEach((end) => end());
    this.worker.terminate();
  }
}
