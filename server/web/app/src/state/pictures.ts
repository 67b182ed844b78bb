// The camera's picture: what is shown of it, and a pause to step through what was seen.
import { computed, signal } from "@preact/signals";
import { NOTHING_TOLD } from "../picture/messages";
import type { RemotePicture } from "../picture/remote";
import { paused } from "./store";

export const framePicture = signal<RemotePicture | null>(null);

const told = computed(() => framePicture.value?.told.value ?? NOTHING_TOLD);
export const shownHead = computed(() => told.value.head);
export const lacking = computed(() => told.value.lacking);
export const link = computed(() => told.value.link);
export const stepsBack = computed(() => told.value.stepsBack);
export const ellipseScale = computed(() => told.value.ellipseScale);
export const frameRatio = computed(() => shownHead.value?.frame_size.join(" / ") ?? "4 / 3");
/** Which slice of a stack is shown, in words. */
export const sliceShown = computed(() => (shownHead.value?.slice ?? []).map((at, i) => `${"zw"[i]} = ${at}`).join(", "));
export const hasSaturated = computed(() => shownHead.value?.hasSaturated ?? false);
export const hasEdge = computed(() => shownHead.value?.hasEdge ?? false);

/** Steps back (−1) or forward (+1) through what was seen before the pause. */
export function step(by: number) {
  paused.value = true;
  framePicture.value?.order({ kind: "step", by });
}

export function pause() {
  paused.value = !paused.value;
}
