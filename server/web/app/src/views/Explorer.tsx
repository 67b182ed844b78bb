// What becomes of a formula: derivative, sums, loop program, the compiler's form, machine code, side by side. What is pointed at in
// one pane is marked in all.
import { batch, signal, useSignal, useSignalEffect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { fill, follow, placeOf } from "../explorer/lines";
import { grouped, plain } from "../format";
import { Formulas, pointed } from "../parts/Formulas";
import { get, said, segment } from "../state/api";
import { centreOf, models, session } from "../state/store";
import type { BodyCost, Explanation, LoopCost, ModelDocument } from "../types";

const METHODS = ["newton", "gauss-newton", "levenberg-marquardt"];
const PANES: { show: string; title: string; what: string; isMath?: true }[] = [
  { show: "formulas", title: "Formulas", what: "as they are written", isMath: true },
  { show: "mathml", title: "Derivative", what: "what F and its derivatives share", isMath: true },
  { show: "sums", title: "Sums", what: "F, its gradient and Hessian, and what is summed", isMath: true },
  { show: "program", title: "Program", what: "the loop nest" },
  { show: "clif", title: "CLIF", what: "the compiler's input" },
  { show: "asm", title: "Machine code", what: "what runs for every four pixels" },
];

/** The model that was chosen last; its document may be on its way. */
let wanted = "";
const model = signal("");
const document_ = signal<ModelDocument | null>(null);
const free = signal<string[]>([]);
const method = signal(METHODS[0]!);
const shown = signal<Record<string, Explanation>>({});
const figures = signal<Explanation[]>([]);
const loops = signal<LoopCost[]>([]);
const fault = signal("");

/** Of a large model the derivation by Newton's method grows past its bounds; its own method does not. */
async function choose(name: string) {
  wanted = name;
  try {
    const found = await get<ModelDocument>(`/v1/models/${segment(name)}`);
    const stage = found.stages?.at(-1);
    const all = Object.keys(found.parameters);
    const centre = centreOf(found).filter((parameter) => all.includes(parameter));
    if (wanted !== name) return;
    batch(() => {
      model.value = name;
      document_.value = found;
      method.value = stage?.method ?? METHODS[0]!;
      free.value = centre.length ? centre : (stage?.parameters ?? all).slice(0, 2);
    });
  } catch (error) {
    fault.value = said(error);
  }
}

async function explain(name: string, parameters: string[], by: string) {
  const ask = (show: string, method: string) => get<Explanation>(
    `/v1/models/${segment(name)}/explain?show=${show}&method=${method}&parameters=${encodeURIComponent(parameters.join(","))}`,
  );
  shown.value = {};
  figures.value = [];
  loops.value = [];
  fault.value = "";
  const isStill = () => model.value === name && free.value === parameters && method.value === by;
  await Promise.all(PANES.filter((pane) => pane.show !== "sums").map(async (pane) => {
    try {
      const found = await ask(pane.show, by);
      if (!isStill()) return;
      const parts = pane.show === "mathml" ? halves(found) : { [pane.show]: found };
      shown.value = { ...shown.value, ...parts };
    } catch (error) {
      if (isStill()) fault.value = said(error);
    }
  }));
  // Measured alone, when the others are there.
  const table = await ask("table", by).catch(() => null);
  if (isStill()) loops.value = table?.loops ?? [];
  const each = await Promise.all(METHODS.map((one) => ask("sums", one).catch(() => null)));
  if (isStill()) figures.value = each.filter((one): one is Explanation => one !== null);
}

/** The derivation before F, and F with what is below: the sums. */
function halves(found: Explanation): Record<string, Explanation> {
  const lines = found.text.split("\n");
  const first = lines.findIndex((line) => /^<math[^>]*>(<mtable[^>]*><mtr><mtd[^>]*>)?<mi>F+<\/mi><mo>=/.test(line));
  const at = first < 0 ? lines.length : first;
  return { mathml: { ...found, text: lines.slice(0, at).join("\n") }, sums: { ...found, text: lines.slice(at).join("\n") } };
}

export function Explorer() {
  const active = session.value?.active_model ?? models.value[0]?.name ?? "";
  useEffect(() => { if (!model.peek() && active) void choose(active); }, [active]);
  useSignalEffect(() => { if (model.value && free.value.length > 0) void explain(model.value, free.value, method.value); });
  const stage = document_.value?.stages?.at(-1);
  const offered = Object.keys(document_.value?.parameters ?? {});
  const toggle = (name: string, isFree: boolean) => {
    const next = offered.filter((one) => (one === name ? isFree : free.value.includes(one)));
    if (next.length > 0) free.value = next;
  };
  return (
    <div class="explorer" data-shown={Object.keys(shown.value).length === PANES.length ? shown.value["asm"]?.digest : undefined}>
      <p class="row bar">
        <label>model <select value={model} onChange={(event) => void choose(event.currentTarget.value)}>
          {models.value.map((one) => <option key={one.name}>{one.name}</option>)}
        </select></label>
        <label>method <select value={method} onChange={(event) => { method.value = event.currentTarget.value; }}>
          {METHODS.map((name) => <option key={name}>{name}</option>)}
        </select></label>
        <span class="row checks" role="group" aria-label="free parameters">free:
          {offered.map((name) => (
            <label key={name}><input type="checkbox" checked={free.value.includes(name)} onChange={(event) => toggle(name, event.currentTarget.checked)} /> {name}</label>
          ))}
        </span>
        {stage && <button onClick={() => { free.value = stage.parameters; }}>As fitted live</button>}
      </p>
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
      <div class="tables"><Loops /><Figures /></div>
      <div class="panes">{PANES.map((pane) => <Pane key={pane.show} {...pane} />)}</div>
    </div>
  );
}

function Pane({ show, title, what, isMath }: (typeof PANES)[number]) {
  const holder = useRef<HTMLDivElement>(null);
  const lines = useSignal(0);
  const found = shown.value[show];
  useEffect(() => {
    if (isMath || !holder.current) return;
    if (found) fill(holder.current, found);
    else holder.current.replaceChildren();
    lines.value = found ? found.text.split("\n").length - 1 : 0;
  }, [found]);
  useEffect(() => (isMath || !holder.current ? undefined : follow(holder.current)), []);
  const point = (event: PointerEvent) => {
    const at = (event.target as Element).closest<HTMLElement>("[data-span], [data-value]");
    pointed.value = at ? placeOf(at) : null;
  };
  return (
    <section class="pane" data-pane={show} aria-label={title}>
      <h3>{title} <small class="quiet">{what}{lines.value > 0 ? ` · ${grouped(lines.value)} lines` : ""}{!found && !fault.value ? " · working …" : ""}</small></h3>
      {isMath
        ? <div class="body">{found && <Formulas text={found.text} />}</div>
        : <div class="body code" ref={holder} tabIndex={0} onPointerOver={point} onPointerLeave={() => { pointed.value = null; }} />}
    </section>
  );
}

/** What a pixel costs by each method. */
function Figures() {
  if (figures.value.length === 0) return <p class="quiet figures-wait">counting …</p>;
  return (
    <div class="scroll panel costs"><table>
      <thead><tr><th>by method</th><th class="number">flops a pixel</th><th class="number">sums</th><th class="number">flops a row</th><th class="number">flops a pass</th><th>calls a pixel</th><th class="number" title="derived, checked and compiled">Compile time</th></tr></thead>
      <tbody>
        {figures.value.map((one) => (
          <tr key={one.method} class={one.method === method.value ? "free" : "held"}>
            <th scope="row">{one.method}</th><td class="number">{grouped(one.flops_per_pixel)}</td><td class="number">{one.accumulators}</td>
            <td class="number">{grouped(one.flops_per_row)}</td><td class="number">{grouped(one.flops_per_pass)}</td>
            <td>{Object.entries(one.calls).map(([name, count]) => `${count} ${name}`).join(", ") || "none"}</td>
            <td class="number">{Math.round(one.compile_ms)} ms</td>
          </tr>
        ))}
      </tbody>
    </table></div>
  );
}

const LOOPS: Record<LoopCost["sums"], string> = { gradient: "gradient", hessian: "Hessian", joint: "both, in one loop" };

/** The two loops one after the other. */
function separate(all: LoopCost[], of: "differentiated" | "compiled"): BodyCost | undefined {
  const [gradient, hessian] = [all[0]?.[of], all[1]?.[of]];
  if (!gradient || !hessian) return undefined;
  const ns = gradient.ns_per_pixel !== undefined && hessian.ns_per_pixel !== undefined ? gradient.ns_per_pixel + hessian.ns_per_pixel : undefined;
  return { flops_per_pixel: gradient.flops_per_pixel + hessian.flops_per_pixel, ns_per_pixel: ns };
}

/** The thesis' Table 6.1 for this model: as the derivatives are written down, and as they are compiled. */
function Loops() {
  const all = loops.value;
  if (all.length === 0) return null;
  const rows: [string, BodyCost | undefined, BodyCost | undefined][] = all.map((one) => [LOOPS[one.sums], one.differentiated, one.compiled]);
  rows.splice(2, 0, ["both, in two loops", separate(all, "differentiated"), separate(all, "compiled")]);
  const flops = (body: BodyCost | undefined) => (body ? grouped(body.flops_per_pixel) : "too large");
  const ns = (body: BodyCost | undefined) => (body?.ns_per_pixel === undefined ? "–" : plain(body.ns_per_pixel, 3));
  const less = (before: number | undefined, after: number | undefined) => (before && after ? `${plain(before / after, 2)} ×` : "–");
  return (
    <div class="scroll panel costs loops"><table>
      <thead>
        <tr class="group"><td /><th colSpan={3}>flops a pixel</th><th colSpan={3} title="8-bit pixels, f32, vectors of 128 bits, one core">ns a pixel</th></tr>
        <tr><th>sums of {free.value.length > 5 ? `${free.value.length} parameters` : free.value.join(" ")}</th>
          {["flops", "ns"].flatMap((what) => ["differentiated", "compiled", "less"].map((word) => <th key={what + word} class="number">{word}</th>))}</tr>
      </thead>
      <tbody>
        {rows.map(([name, before, after]) => (
          <tr key={name} class={name === LOOPS.joint ? "free" : "held"}>
            <th scope="row">{name}</th><td class="number">{flops(before)}</td><td class="number">{flops(after)}</td><td class="number">{less(before?.flops_per_pixel, after?.flops_per_pixel)}</td>
            <td class="number">{ns(before)}</td><td class="number">{ns(after)}</td><td class="number">{less(before?.ns_per_pixel, after?.ns_per_pixel)}</td>
          </tr>
        ))}
      </tbody>
    </table></div>
  );
}
