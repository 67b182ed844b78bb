// Where pictures come from: sessions to start and stop, cameras with their controls, recordings, the synthetic camera and how to
// break what it shows, and single images.
import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { beginDemo } from "../state/demo";
import { said, segment, send } from "../state/api";
import { chosen, look, models, refresh, session, sessions, sources } from "../state/store";
import { Screen } from "../parts/Screen";
import { CameraList, CameraPanel, cameras } from "../sources/Camera";
import { ImageFit } from "../sources/ImageFit";
import { PlaybackPanel } from "../sources/Playback";
import { RecordedFiles, RecordingPanel } from "../sources/Recording";
import { ScenePanel } from "../sources/Scene";

export function Sources() {
  const one = session.value;
  const name = typeof one?.source === "string" ? one.source : "";
  const source = sources.value.find((each) => each.name === name);
  return (
    <div class="sources">
      <div class="column">
        {one && <Screen />}
        <SessionList />
        <StartForm />
      </div>
      <div class="column">
        {source?.kind === "synthetic" && <ScenePanel key={source.name} source={source} />}
        {(source?.kind === "synthetic" || source?.kind === "recording") && <PlaybackPanel key={`play-${source.name}`} source={source} />}
        {source?.kind === "camera" && <CameraPanel key={source.name} device={String(source["device"] ?? "")} />}
        {source?.kind === "pushed" && (
          <section class="panel"><h3>{source.name} <small class="quiet">pushed frames</small></h3>
            <p>Your program sends them: <code>POST /v1/sessions/{one?.name}/frames</code> (<a href="/docs/api.html#pushed-frames">how</a>).</p></section>
        )}
        {one && !source && <p class="panel quiet">The source of {one.name} is its own, without a name: it can be neither set nor shared. Start it under a name to do that.</p>}
        {one && <RecordingPanel key={`record-${one.name}`} of={one} />}
        <RecordedFiles />
        <ImageFit />
        <CameraList />
      </div>
    </div>
  );
}

function sourceName(source: unknown): string {
  if (typeof source === "string") return source;
  return String((source as { kind?: string } | null)?.kind ?? "");
}

function SessionList() {
  const fault = useSignal("");
  const stop = async (name: string) => {
    try {
      await send("DELETE", `/v1/sessions/${segment(name)}`);
      fault.value = "";
      await refresh();
    } catch (error) {
      fault.value = said(error);
    }
  };
  return (
    <section class="panel late">
      <h3>Sessions <small class="quiet">a model fitted to every frame of a source</small></h3>
      {sessions.value.length === 0 && <p class="row"><span class="quiet">None yet.</span>
        <button onClick={() => beginDemo().then((told) => { fault.value = told; })}>Start the demo</button></p>}
      <div class="scroll"><table>
        <tbody>
          {sessions.value.map((one) => (
            <tr key={one.name} class={one.name === chosen.value ? "free" : ""}>
              <th scope="row">{one.name === chosen.value ? <b>{one.name}</b> : one.name}</th>
              <td class="wrap">{one.active_model}<br /><small class="quiet">{sourceName(one.source)}</small></td>
              <td>{one.state.replace("_", " ")}<br /><small class="quiet">{one.rate_hz.toFixed(1)} Hz</small></td>
              <td class="row">
                {one.name !== chosen.value && <button onClick={() => look(one.name)}>Look</button>}
                <button aria-label={`stop ${one.name}`} onClick={() => void stop(one.name)}>Stop</button>
              </td>
            </tr>
          ))}
        </tbody>
      </table></div>
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
    </section>
  );
}

const KINDS = ["source that runs", "synthetic", "camera", "recording", "pushed"] as const;

function StartForm() {
  const name = useSignal("");
  const model = useSignal("spot");
  const kind = useSignal<(typeof KINDS)[number]>("synthetic");
  const where = useSignal("");
  const size = useSignal("640x480");
  const fault = useSignal("");
  useEffect(() => { if (kind.value === "source that runs" && !where.value) where.value = sources.value[0]?.name ?? ""; }, [kind.value]);
  const start = async (event: Event) => {
    event.preventDefault();
    const own = name.value || "session";
    const moving = { bx: "320 + 110*sin(2*pi*0.2*t)", by: "240 + 70*cos(2*pi*0.13*t)" };
    const documents: Record<string, Record<string, unknown>> = {
      synthetic: { kind: "synthetic", model: model.value, rate_hz: 30, samples: 2, full_well_e: 5000, read_noise_e: 15, motion: model.value === "spot" ? moving : {} },
      camera: { kind: "camera", device: where.value },
      pushed: { kind: "pushed", width: Number(size.value.split("x")[0]), height: Number(size.value.split("x")[1]), format: "u8" },
      recording: { kind: "recording", path: where.value, rate_hz: 30, loop: true },
    };
    try {
      const made = documents[kind.value];
      const source = made ? own : where.value;
      if (made) await send("PUT", `/v1/sources/${segment(own)}`, made);
      await send("PUT", `/v1/sessions/${segment(own)}`, { source, model: model.value });
      fault.value = "";
      await refresh();
      look(own);
    } catch (error) {
      fault.value = said(error);
    }
  };
  return (
    <form class="panel fields late" onSubmit={(event) => void start(event)}>
      <h3>Start a session</h3>
      <label>name <input value={name} placeholder="session" pattern="[a-z0-9][a-z0-9\-]{0,63}" onInput={(event) => { name.value = event.currentTarget.value; }} /></label>
      <label>model <select value={model} onChange={(event) => { model.value = event.currentTarget.value; }}>
        {models.value.map((one) => <option key={one.name}>{one.name}</option>)}
      </select></label>
      <label>Source <select value={kind} onChange={(event) => { where.value = ""; kind.value = event.currentTarget.value as typeof kind.value; }}>
        {KINDS.map((one) => <option key={one}>{one}</option>)}
      </select></label>
      {kind.value === "source that runs" && (
        <label>source <select value={where} onChange={(event) => { where.value = event.currentTarget.value; }}>
          {sources.value.map((one) => <option key={one.name}>{one.name}</option>)}
        </select></label>
      )}
      {kind.value === "camera" && <label>device <input required value={where} placeholder="/dev/video0" list="cameras" onInput={(event) => { where.value = event.currentTarget.value; }} /></label>}
      {kind.value === "camera" && <datalist id="cameras">{cameras.value?.map((one) => <option key={one.identity} value={one.identity}>{one.name}</option>)}</datalist>}
      {kind.value === "pushed" && <label>width x height in px, 8 bit <input required value={size} pattern="[0-9]+x[0-9]+" onInput={(event) => { size.value = event.currentTarget.value; }} /></label>}
      {kind.value === "recording" && <label>path on the service's machine <input required value={where} placeholder="/data/run-7" onInput={(event) => { where.value = event.currentTarget.value; }} /></label>}
      <button class="primary">Start</button>
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
    </form>
  );
}
