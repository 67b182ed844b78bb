// Formulas as the service prints them: MathML, each node with its bytes of the document. What is pointed at here is marked in the
// other panes, and the other way round. Nothing of it is taken as HTML: known elements are made anew, one by one.
import { signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";

/** Bytes of the document that are pointed at, and the program's value where that is known. */
export interface Pointed { span: [number, number] | null; value: number | null }

export const pointed = signal<Pointed | null>(null);

const MATHML = "http://www.w3.org/1998/Math/MathML";
const ELEMENTS = new Set([
  "math", "mrow", "mi", "mn", "mo", "mtext", "msub", "msup", "msubsup", "mfrac", "msqrt", "munder", "munderover", "mover",
  "mtable", "mtr", "mtd", "mspace",
]);
const ATTRIBUTES = ["display", "form", "mathvariant", "lspace", "rspace", "displaystyle", "movablelimits", "data-span", "data-key"];

function copied(from: Element, into: Element) {
  for (const node of from.childNodes) {
    if (node.nodeType === Node.TEXT_NODE) {
      into.append(node.textContent ?? "");
    } else if (node instanceof Element && ELEMENTS.has(node.localName)) {
      if (node.localName === "mo" && isFence(node)) continue;
      const made = document.createElementNS(MATHML, node.localName);
      for (const name of ATTRIBUTES) {
        const value = node.getAttribute(name);
        if (value !== null) made.setAttribute(name, value);
      }
      if (node.localName === "mtable") {
        const before = node.previousElementSibling;
        if (before && isFence(before)) made.setAttribute("class", before.textContent === "{" ? "cases" : "matrix");
      }
      const aligned = /text-align:(left|right)/.exec(node.getAttribute("style") ?? "");
      if (aligned) made.setAttribute("class", `to-${aligned[1]}`);
      copied(node, made);
      if (node.localName === "mn") made.textContent = shortened(made.textContent ?? "");
      into.append(made);
    }
  }
}

/** Six digits of those that nobody reads; the program has them all. */
function shortened(number: string): string {
  return /^\d*\.\d{7,}$/.test(number) ? Number(number).toPrecision(6) : number;
}

/** A bracket beside a table: drawn by the style, since few machines have a font whose brackets grow. */
function isFence(sign: Element): boolean {
  const next = sign.nextElementSibling;
  const before = sign.previousElementSibling;
  return (next?.localName === "mtable" && /^[({]$/.test(sign.textContent ?? "")) || (before?.localName === "mtable" && sign.textContent === ")");
}

/** Formulas, one a line, as elements. */
export function mathElements(text: string): Element[] {
  const parser = new DOMParser();
  return text.split("\n").filter(Boolean).flatMap((line) => {
    const read = parser.parseFromString(`<div>${line}</div>`, "application/xml");
    const holder = document.createElement("div");
    holder.className = "formula";
    copied(read.documentElement, holder);
    return holder.firstChild ? [holder] : [];
  });
}

export function spanOf(element: Element): [number, number] | null {
  const found = /^(\d+)-(\d+)$/.exec(element.getAttribute("data-span") ?? "");
  return found ? [Number(found[1]), Number(found[2])] : null;
}

/** Marks the nodes that stand for these bytes: those of exactly these, else the smallest around them. */
function mark(holder: Element, wanted: [number, number] | null) {
  for (const node of holder.querySelectorAll(".pointed")) node.classList.remove("pointed");
  if (!wanted) return;
  let [best, size] = [[] as Element[], Infinity];
  for (const node of holder.querySelectorAll("[data-span]")) {
    const span = spanOf(node)!;
    if (span[0] > wanted[0] || span[1] < wanted[1]) continue;
    const own = span[1] - span[0];
    if (own < size) [best, size] = [[node], own];
    else if (own === size) best.push(node);
  }
  for (const node of best) node.classList.add("pointed");
}

export function Formulas({ text, keys }: { text: string; keys?: (key: string) => boolean }) {
  const holder = useRef<HTMLDivElement>(null);
  useEffect(() => {
    const made = mathElements(text).filter((line) => !keys || keys(line.firstElementChild?.getAttribute("data-key") ?? ""));
    holder.current!.replaceChildren(...made);
  }, [text]);
  useEffect(() => pointed.subscribe((now) => holder.current && mark(holder.current, now?.span ?? null)), []);
  const point = (event: PointerEvent) => {
    const at = (event.target as Element).closest("[data-span]");
    pointed.value = at ? { span: spanOf(at), value: null } : null;
  };
  return <div ref={holder} class="formulas" onPointerOver={point} onPointerLeave={() => { pointed.value = null; }} />;
}
