// Lines of code that know which value they compute and which bytes of the document asked for it.
import { pointed, spanOf, type Pointed } from "../parts/Formulas";
import type { Explanation } from "../types";

/** Of an instruction, without the comment that says what is marked anyway. */
function code(line: string, isAnnotated: boolean): string {
  const at = isAnnotated ? line.search(/\s*; v\d/) : -1;
  return at >= 0 ? line.slice(0, at) : line;
}

/** Fills a pane. */
export function fill(pane: HTMLElement, explanation: Explanation) {
  const isAnnotated = explanation.show === "clif" || explanation.show === "asm";
  const made = explanation.text.split("\n").map((line, i) => {
    const element = document.createElement("div");
    element.hidden = isAnnotated && i === 0; // says what the comments are, which are marked instead
    element.textContent = code(line, isAnnotated) || " ";
    const place = explanation.lines?.[i];
    if (place?.value !== undefined) element.dataset.value = String(place.value);
    if (place?.span) element.dataset.span = place.span.join("-");
    if (isAnnotated) element.title = line.slice(element.textContent.length).trim().replace(/^;\s*/, "");
    return element;
  });
  pane.replaceChildren(...made);
}

export function placeOf(element: HTMLElement): Pointed | null {
  const value = element.dataset.value;
  const span = spanOf(element);
  return value === undefined && !span ? null : { span, value: value === undefined ? null : Number(value) };
}

/** Which lines of a pane are meant: those of the value, else those of bytes inside, else those of the least bytes around. */
export function meant(lines: HTMLElement[], now: Pointed): HTMLElement[] {
  if (now.value !== null) return lines.filter((line) => line.dataset.value === String(now.value));
  const wanted = now.span;
  if (!wanted) return [];
  const spans = lines.map((line) => [line, spanOf(line)] as const).filter(([, span]) => span);
  const inside = spans.filter(([, span]) => span![0] >= wanted[0] && span![1] <= wanted[1]);
  if (inside.length > 0) return inside.map(([line]) => line);
  let least = Infinity;
  let best: HTMLElement[] = [];
  for (const [line, span] of spans) {
    const size = span![1] - span![0];
    if (span![0] > wanted[0] || span![1] < wanted[1] || size > least) continue;
    if (size < least) [least, best] = [size, []];
    best.push(line);
  }
  return best;
}

/** Keeps a pane marked as something is pointed at, and scrolls to it unless it is this pane that is pointed at. */
export function follow(pane: HTMLElement): () => void {
  return pointed.subscribe((now) => {
    for (const line of pane.querySelectorAll(":scope > .pointed")) line.classList.remove("pointed");
    if (!now) return;
    const found = meant([...pane.children] as HTMLElement[], now);
    for (const line of found) line.classList.add("pointed");
    const first = found[0];
    if (!first || pane.matches(":hover")) return;
    const isSeen = first.offsetTop >= pane.scrollTop && first.offsetTop < pane.scrollTop + pane.clientHeight - 20;
    if (!isSeen) pane.scrollTop = first.offsetTop - pane.clientHeight / 3;
  });
}
