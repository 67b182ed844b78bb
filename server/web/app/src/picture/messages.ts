// What the page and the thread of a picture say to each other.
import type { PreviewHead } from "../types";

/** What is to be shown, of whom, and how large. */
export interface Look {
  /** Device pixels, and how many of them a CSS pixel has. */
  width: number;
  height: number;
  ratio: number;
  /** The parameters that are the target's centre. */
  centre: string[];
  /** Pictures a second that the session could give. */
  rateHz: number;
  isHidden: boolean;
  isPaused: boolean;
  /** CSS pixels; null where no pointer is on the picture. */
  pointer: { x: number; y: number } | null;
}

export type Part = "frame" | "residual";

export type Order =
  | { kind: "begin"; canvas: OffscreenCanvas; part: Part }
  | { kind: "follow"; path: string; protocols: string[] }
  | { kind: "look"; look: Partial<Look> }
  | { kind: "zoom"; factor: number; at?: { x: number; y: number } }
  | { kind: "pan"; dx: number; dy: number }
  | { kind: "fit" }
  | { kind: "stretch" }
  /** Back (−1) or forward (+1) through what was seen before the pause. */
  | { kind: "step"; by: number }
  /** To the last picture that was seen before a frame of that number came. */
  | { kind: "seek"; frame: number };

/** What of a picture's head changes the page around it. */
export type ShownHead = Pick<PreviewHead, "frame" | "frame_size" | "slice" | "width" | "height" | "section"> & {
  hasSaturated: boolean;
  /** The edge of the domain is drawn beside the outline. */
  hasEdge: boolean;
};

/** What a picture's thread tells, a few times a second. */
export interface Told {
  head: ShownHead | null;
  /** Why there is no picture; empty where there is one. */
  lacking: string;
  /** How pictures come: for people. */
  link: string;
  /** What is under the pointer. */
  value: string;
  stepsBack: number;
  ellipseScale: number;
  isZoomed: boolean;
}

export const NOTHING_TOLD: Told = { head: null, lacking: "waiting for the first picture …", link: "", value: "", stepsBack: 0, ellipseScale: 1, isZoomed: false };
