// In which state a session is, in one word, with what to do about it. Each has its own look in the style.
import { computed } from "@preact/signals";
import { entrance } from "./api";
import { newest, service, session, sessions, sources } from "./store";
import type { Estimate, Quality } from "../types";

export interface Standing {
  word: string;
  /** Also told apart without colour. */
  sign: string;
  hint: string;
}

export function standingClass(word: string): string {
  return `is-${word.replace(/\W+/g, "-")}`;
}

/** From here on what a fit leaves unexplained is more than noise, and seen in the residual. */
const MISFIT_CHI_SQUARE = 3;
/** Below this what is tracked is hardly what the formula says. */
const CONFIDENCE_LEAST = 0.1;

let last: Standing = { word: "", sign: "", hint: "" };

/** The same object as long as it says the same, so that nothing is drawn anew with each frame. */
export const standing = computed<Standing>(() => {
  const now = told();
  if (now.word !== last.word || now.hint !== last.hint) last = now;
  return last;
});

function told(): Standing {
  if (entrance.value) return { word: "locked", sign: "⚿", hint: "Give a token to see this service." };
  if (service.value.state === "away") {
    return { word: "disconnected", sign: "⨯", hint: "The service does not answer. The page tries again every second." };
  }
  if (service.value.state === "connecting") return { word: "connecting", sign: "…", hint: "Asking the service." };
  if (sessions.value.length === 0) {
    return { word: "first start", sign: "✦", hint: "No session yet. Start one under Sources, or the demo below." };
  }
  const one = session.value;
  const reason = one?.reason ? ` ${one.reason}` : "";
  switch (one?.state) {
    case "starting": return { word: "starting", sign: "…", hint: `Waiting for the first frame.${reason}` };
    case "stalled": return { word: "stalled", sign: "‖", hint: `No frames come. Look at the source: is it paused, or the camera in use?${reason}` };
    case "lost_source": return { word: "source lost", sign: "⨯", hint: `The camera is gone. Plug it in again: the session goes on by itself.${reason}` };
    case "stopped": return { word: "ended", sign: "■", hint: `The source has no more frames. Start it again under Sources.${reason}` };
    case "failed": return { word: "failed", sign: "!", hint: `It cannot go on.${reason} Mend that, and start it again under Sources.` };
  }
  const source = sources.value.find((each) => each.name === one?.source);
  if ((source?.["playback"] as { paused?: boolean } | undefined)?.paused) {
    return { word: "held", sign: "‖", hint: "The source is held. Play or step it under Sources." };
  }
  const estimate = newest.value;
  if (!estimate) return { word: "empty", sign: "○", hint: "No estimate yet." };
  return ofEstimate(estimate);
}

function ofEstimate(estimate: Estimate): Standing {
  if (isMisfit(estimate)) {
    return { word: "misfit", sign: "≠", hint: "The formula leaves more than noise unexplained: look at the residual, and try another formula." };
  }
  switch (estimate.state) {
    case "tracking": return { word: "tracking", sign: "●", hint: "" };
    case "coasting": return { word: "coasting", sign: "◌", hint: "Not seen in this frame: predicted from how it moved." };
    case "lost": return { word: "lost", sign: "?", hint: `${found(estimate)} Bring it back into the picture, or give it more light.` };
    default: return { word: "searching", sign: "⌕", hint: `${found(estimate)} Every frame is searched. Is the target in the picture, sharp, and brighter than its surroundings?` };
  }
}

function found(estimate: Estimate): string {
  if (estimate.rejection === "one-of-several") return "Several things stand out, and any may be the target: a window or a start says which.";
  if (estimate.rejection === "unlike") return "What stands out looks otherwise than the target that was followed.";
  const strongest = estimate.strongest;
  if (!strongest) return "Nothing that looks like the target.";
  return `The strongest thing stands ${strongest.score.toFixed(1)} σ out of the noise; ${strongest.threshold.toFixed(1)} σ are needed.`;
}

function isMisfit(estimate: Estimate): boolean {
  const isBad = estimate.rejection === "misfit" || estimate.rejection === "unlikely";
  const isDoubtful = estimate.state === "tracking" && (estimate.confidence ?? 1) < CONFIDENCE_LEAST;
  return isBad || isDoubtful || (estimate.state === "tracking" && (estimate.reduced_chi_square ?? 1) > MISFIT_CHI_SQUARE && estimate.noise_ratio !== undefined);
}

/** One entry of an estimate's quality, in a few words. */
function remark({ code, sigma, share, place, parameters, factor }: Quality): { word: string; why: string } {
  const percent = share === undefined ? "" : `${(100 * share).toFixed(1)} %`;
  switch (code) {
    case "misfit": return { word: `misfit ${percent}`, why: `Residuals are ${sigma?.toFixed(0)} σ larger than noise${percent ? `, ${percent} of the target's height` : ""}.` };
    case "rough-model": return { word: "rough model", why: "The residuals are rather those of another profile." };
    case "ambiguous": return { word: "ambiguous", why: `Something else may be the target${place ? `, at ${place.map((at) => at.toFixed(0)).join(", ")}` : ""}: a window or a start says which.` };
    case "saturated": return { word: `saturated ${percent}`, why: "Pixels at the limit: give it less light." };
    case "covered": return { word: `covered ${percent}`, why: "Something is in front of the target." };
    case "at-bound": return { word: `at bound: ${parameters?.join(", ")}`, why: "A min or max of the document holds these back." };
    case "cut-off": return { word: `cut off ${percent}`, why: "The target reaches beyond the picture." };
    case "noisier": return { word: `noise × ${factor?.toFixed(2)}`, why: "Pixels are noisier than the document states." };
    case "quieter": return { word: `noise × ${factor?.toFixed(2)}`, why: "The document states far more noise than the pixels have." };
    default: return { word: code, why: "" };
  }
}

/** What is odd about an estimate, each in a few words. */
export function remarks(estimate: Estimate): { word: string; why: string }[] {
  const found: { word: string; why: string }[] = [];
  for (const quality of estimate.quality ?? []) found.push(remark(quality));
  if (estimate.ending === "singular") found.push({ word: "singular", why: "Some parameters cannot be told apart in this picture." });
  if (estimate.ending === "budget") found.push({ word: "slow", why: "The fit took longer than a frame may, and ended with its best so far." });
  if (estimate.ending === "iteration-limit") found.push({ word: "iteration limit", why: "Perhaps not the minimum: give the stage more iterations." });
  if (estimate.substitute) found.push({ word: "substitute", why: "The model left too much unexplained: an alternative of it was fitted." });
  if (estimate.rejection && estimate.rejection !== "misfit") found.push({ word: estimate.rejection, why: "Why this fit is not taken for the target." });
  return found;
}
