// The pictures that are on the page: streams that run while somebody looks, what was shown last, and a pause to step through.
import { computed, signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import type { Picture } from "../draw/picture";
import type { PreviewHead } from "../types";
import { entered } from "./api";
import { preview, type Preview } from "./preview";
import { chosen, paused, session } from "./store";

export const framePicture = signal<Picture | null>(null);
export const residualPicture = signal<Picture | null>(null);
/** What stood before the pixels of the picture shown. */
export const shownHead = signal<PreviewHead | null>(null);
/** Why there is no picture; empty where there is one. */
export const lacking = signal("waiting for the first picture …");
export const lackingResidual = signal("");
export const residualRatio = signal("1 / 1");
/** What of the picture's head changes the page around it. */
export const frameRatio = computed(() => shownHead.value?.frame_size.join(" / ") ?? "4 / 3");
export const hasSaturated = computed(() => (shownHead.value?.saturated?.length ?? 0) > 0);
export const stepsBack = signal(0);

/** Pictures that are kept to step back through when paused. */
const KEPT_BYTES = 24_000_000;
const kept: Preview[] = [];
let keptBytes = 0;

/** What a picture takes, its pixels decoded. */
function bytesOf({ pixels, bitmap }: Preview): number {
  return pixels.length + (bitmap ? 4 * bitmap.width * bitmap.height : 0);
}

function keep(shown: Preview) {
  kept.push(shown);
  keptBytes += bytesOf(shown);
  while (keptBytes > KEPT_BYTES && kept.length > 1) drop(kept.shift()!);
}

function drop(old: Preview) {
  keptBytes -= bytesOf(old);
  old.bitmap?.close();
}

/** Steps back (−1) or forward (+1) through what was seen before the pause. */
export function step(by: number) {
  paused.value = true;
  stepsBack.value = Math.max(0, Math.min(kept.length - 1, stepsBack.value - by));
  const at = kept[kept.length - 1 - stepsBack.value];
  if (!at) return;
  framePicture.value?.show(at);
  shownHead.value = at.head;
}

export function pause() {
  paused.value = !paused.value;
  stepsBack.value = 0;
}

/** In few steps, so that the layout stands still while a window breathes. */
function aspect(width: number, height: number): string {
  const ratio = Math.max(0.7, Math.min(1.8, width / Math.max(1, height)));
  return `${Math.round(ratio * 5) / 5} / 1`;
}

/** Streams pictures of the session looked at while the component is on the page. */
export function usePictures(parts: "frame" | "frame and residual") {
  useEffect(() => {
    const name = chosen.value;
    if (!name) return;
    const wanted = () => Math.min(30, session.peek()?.rate_hz || 30);
    kept.splice(0).forEach(drop);
    lacking.value = "waiting for the first picture …";
    const frames = preview(name, "frame", wanted, {
      show(message) {
        lacking.value = "";
        if (paused.peek()) return;
        keep(message);
        framePicture.peek()?.show(message);
        shownHead.value = message.head;
      },
      gone(reason) { lacking.value = reason || "no picture: the service has closed the stream; trying again"; },
    });
    const residuals = parts === "frame" ? null : preview(name, "residual", wanted, {
      show(message) {
        lackingResidual.value = "";
        residualRatio.value = aspect(message.head.width, message.head.height);
        if (!paused.peek()) residualPicture.peek()?.show(message);
      },
      gone(reason) { lackingResidual.value = reason || "no residual yet"; },
    });
    return () => { frames.close(); residuals?.close(); };
  }, [chosen.value, entered.value]);
}
