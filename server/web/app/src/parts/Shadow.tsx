// A shadow: the edited model on the session's own frames, beside it, before it takes over.
import { useSignal } from "@preact/signals";
import { put } from "../editor/draft";
import { modelName, plain } from "../format";
import { Residual } from "./Residual";
import { said, segment, send } from "../state/api";
import { beat, current, hasPlace, newest, refresh, session } from "../state/store";
import { swapNews } from "../state/swap";

/** Puts the document, and lets it run beside the session's model. */
export function ShadowButton({ model }: { model: string }) {
  const told = useSignal("");
  const one = session.value;
  if (!one || one.shadow) return null;
  const begin = async () => {
    if (!(await put("shadow"))) return;
    try {
      await send("PUT", `/v1/sessions/${segment(one.name)}/shadow`, { model });
      told.value = "";
      await refresh();
    } catch (error) {
      told.value = said(error);
    }
  };
  return (
    <>
      <button id="shadow" onClick={() => void begin()} title="put it, and fit it beside the session's model, on the same frames">Shadow</button>
      {told.value && <span class="fault" role="alert">{told.value}</span>}
    </>
  );
}

/** Both models, side by side. */
export function ShadowPanel() {
  void beat.value;
  const told = useSignal("");
  const one = session.value;
  const shadow = one?.shadow;
  if (!one || !shadow) return null;
  const own = newest.peek();
  const last = shadow.last;
  const act = async (method: "POST" | "DELETE", path: string) => {
    try {
      const answer = await send<NonNullable<typeof swapNews.value>["answer"]>(method, `/v1/sessions/${segment(one.name)}/${path}`);
      if (answer) swapNews.value = { requested: shadow.model, isWaiting: false, answer, fault: "" };
      await refresh();
    } catch (error) {
      told.value = said(error);
    }
  };
  const [ownNow, lastNow] = [current(), last && hasPlace(last.estimate) ? last.estimate : undefined];
  const figure = (value: number | undefined, unit = "") => (value === undefined ? "–" : `${plain(value, 3)}${unit}`);
  const rows: [string, string, string][] = [
    ["model", one.active_model, last ? modelName(last.estimate.model) : shadow.model],
    ["state", own?.state ?? "–", last?.estimate.state ?? shadow.state],
    ["χ²/ν", figure(ownNow?.reduced_chi_square), figure(lastNow?.reduced_chi_square)],
    ["confidence", figure(ownNow?.confidence), figure(lastNow?.confidence)],
    ["fit", figure(own?.timing_us && own.timing_us.fit / 1000, " ms"), figure(last?.estimate.timing_us && last.estimate.timing_us.fit / 1000, " ms")],
    ["frames lost", String(one.dropped), String(shadow.dropped)],
  ];
  const areBoth = ownNow !== null && lastNow !== undefined;
  const parameters = areBoth ? Object.entries(last?.parameters ?? {}) : [];
  return (
    <section class="panel" aria-label="shadow">
      <h3>Shadow <small class="quiet">{shadow.state}{shadow.reason ? ` · ${shadow.reason}` : ""} · both on the same frames</small></h3>
      <div class="scroll"><table>
        <thead><tr><th /><th class="number">session</th><th class="number">shadow</th></tr></thead>
        <tbody>{rows.map(([name, left, right]) => <tr key={name}><th scope="row">{name}</th><td class="number">{left}</td><td class="number">{right}</td></tr>)}</tbody>
      </table></div>
      <div class="pair">
        <Residual title="Residual of the session" />
        {last && <Residual key={shadow.model} title="Residual of the shadow" shadow />}
      </div>
      {areBoth && last?.centre_px !== undefined && <p>Their centres are {plain(last.centre_px, 2)} px apart.</p>}
      {parameters.length > 0 && (
        <p class="quiet">{parameters.map(([name, one]) => `${name} ${plain(one.difference, 2)}${one.deviations === undefined ? "" : ` (${plain(one.deviations, 2)} σ)`}`).join(" · ")}</p>
      )}
      <p class="row">
        <button class="primary" onClick={() => void act("POST", "shadow:promote")}>Promote</button>
        <button onClick={() => void act("DELETE", "shadow")}>Drop</button>
        {told.value && <span class="fault" role="alert">{told.value}</span>}
      </p>
    </section>
  );
}
