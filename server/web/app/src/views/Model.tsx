// The document, what it says as mathematics, and what the service says of it. Ctrl-Enter puts it and swaps the session to it.
import { useEffect } from "preact/hooks";
import { Editor } from "../editor/Editor";
import { apply, conflict, draft, faults, open, readVersions, replaceTheirs, report, rollBack, takeTheirs, trouble, versions, type Version } from "../editor/draft";
import { plain } from "../format";
import { Formulas } from "../parts/Formulas";
import { ShadowButton, ShadowPanel } from "../parts/Shadow";
import { Parameters } from "../parts/Parameters";
import { Screen } from "../parts/Screen";
import { SwapLine } from "../parts/SwapLine";
import { models, session, sessions } from "../state/store";
import { unsaved } from "../state/unsaved";

export function ModelView() {
  const active = session.value?.active_model ?? models.value[0]?.name ?? "";
  useEffect(() => { if (!draft.name.peek() && active) open(active); }, [active]);
  const isKnown = models.value.some((model) => model.name === draft.name.value);
  return (
    <div class="model">
      <div class="edit">
        <p class="row bar">
          <label>open <select aria-label="open a model" value={isKnown ? draft.name.value : ""} onChange={(event) => { if (!open(event.currentTarget.value)) event.currentTarget.value = isKnown ? draft.name.peek() : ""; }}>
            {!isKnown && <option value="">{draft.name.value}</option>}
            {models.value.map((model) => <option key={model.name} value={model.name}>{model.name}</option>)}
          </select></label>
          <label>Save as <input size={14} value={draft.name} pattern="[a-z0-9][a-z0-9\-]{0,63}" onInput={(event) => { draft.name.value = event.currentTarget.value; void readVersions(); }} /></label>
          <button class="primary" id="apply" disabled={faults.value.length > 0} onClick={() => void apply()} title="put it and fit it (Ctrl-Enter)">Apply</button>
          <ShadowButton model={draft.name.value} />
          <span class="quiet">{unsaved.value ? "changed" : ""}</span>
        </p>
        <Editor apply={() => void apply()} />
        <SwapLine />
      </div>
      <div class="said">
        <Conflict />
        <Faults />
        {session.value && <Screen />}
        {session.value && <section class="panel" aria-label="parameters"><Parameters /></section>}
        <ShadowPanel />
        <section class="panel" aria-label="formulas">
          <h3>As mathematics <small class="quiet">point at a term to see where it stands</small></h3>
          {report.value && <Formulas text={report.value.formulas} />}
        </section>
        <Costs />
        <History />
      </div>
    </div>
  );
}

function Faults() {
  if (trouble.value && faults.value.length === 0) return <p class="panel fault" role="alert">{trouble.value}</p>;
  if (faults.value.length === 0) return null;
  return (
    <ul class="panel faults" role="alert" aria-label="what is wrong">
      {faults.value.map((fault, i) => (
        <li key={i}><b>{fault.line}:{fault.column}</b> {fault.message}{fault.help && <span class="quiet"> · {fault.help}</span>}</li>
      ))}
    </ul>
  );
}

function Costs() {
  const found = report.value;
  if (!found) return null;
  const deviation = found.bound?.deviation ?? {};
  return (
    <section class="panel">
      <h3>What it costs <small class="quiet">a stage a row</small></h3>
      <div class="scroll"><table>
        <thead><tr><th>free parameters</th><th>method</th><th class="number">flops a pixel</th><th class="number">sums</th><th class="number">compiled in</th><th class="number" title="of the Fisher information, scaled; near 0 where parameters cannot be told apart">condition</th></tr></thead>
        <tbody>
          {found.stages.map((stage, i) => (
            <tr key={i}><td class="wrap">{stage.parameters.join(" ")}</td><td>{stage.method}</td><td class="number">{stage.flops_per_pixel}{Object.entries(stage.calls).map(([name, count]) => ` + ${count} ${name}`)}</td>
              <td class="number">{stage.accumulators}</td><td class="number">{plain(stage.compile_ms, 3)} ms</td><td class="number">{stage.condition === undefined ? "–" : plain(stage.condition, 2)}</td></tr>
          ))}
        </tbody>
      </table></div>
      {Object.keys(deviation).length > 0 && (
        <>
          <h3>Least deviations <small class="quiet">of a made-up target of 12 px (Cramér–Rao)</small></h3>
          <div class="scroll"><table>
            <thead><tr><th>parameter</th><th class="number">there</th><th class="number">σ at best</th></tr></thead>
            <tbody>{Object.entries(deviation).map(([name, sigma]) => (
              <tr key={name}><td>{name}</td><td class="number">{plain(found.bound?.parameters[name] ?? NaN, 4)}</td><td class="number">{plain(sigma, 2)}</td></tr>
            ))}</tbody>
          </table></div>
        </>
      )}
    </section>
  );
}

/** Somebody else was faster: theirs can be seen before one of the two goes. */
function Conflict() {
  const found = conflict.value;
  if (!found) return null;
  const { name, theirs } = found;
  return (
    <section class="panel conflict" role="alert" aria-label="changed by somebody else">
      <h3>Not stored: somebody else {theirs ? `has stored another ${name}` : `has removed ${name}`} since you opened it</h3>
      {theirs && <details><summary>See theirs</summary><pre tabIndex={0}>{theirs.text}</pre></details>}
      <p class="row">
        {theirs && <button onClick={takeTheirs}>Open theirs</button>}
        <button onClick={() => { replaceTheirs(); void apply(); }}>{theirs ? "Replace theirs with mine" : "Store mine"}</button>
      </p>
    </section>
  );
}

/** Which sessions fit that version of the draft's model: of several versions with the same formulas the one that the name means, else the newest. */
function usersOf(version: Version): string[] {
  const alike = versions.value.filter((one) => one.digest === version.digest);
  if ((alike.find((one) => one.active) ?? alike[0]) !== version) return [];
  return sessions.value.filter((one) => one.active_model === draft.name.value && one.active_digest === version.digest).map((one) => one.name);
}

function History() {
  if (versions.value.length === 0) return null;
  return (
    <section class="panel" aria-label="history">
      <h3>History <small class="quiet">{draft.name}</small></h3>
      <div class="scroll versions"><table>
        <tbody>
          {versions.value.map((version) => {
            const users = usersOf(version);
            return (
              <tr key={version.version}>
                <th scope="row">version {version.version}</th>
                <td class="quiet">{version.created_at?.replace("T", " ").replace(/\..*|Z$/, "") ?? "shipped"}</td>
                <td class="quiet digest">{version.digest.slice(7, 15)}</td>
                <td class="wrap">{users.length > 0 ? <b>in use by {users.join(", ")}</b> : version.active ? <span class="quiet">current, not in use</span> : ""}</td>
                <td>{!version.active && <button onClick={() => void rollBack(version.version)}>Roll back</button>}</td>
              </tr>
            );
          })}
        </tbody>
      </table></div>
    </section>
  );
}
