// Keeps what a session sees and says, and fits it again. What is recorded is the service's to say: it goes on whoever looks.
import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { grouped } from "../format";
import { Refused, get, hasToken, newestOnly, said, segment, send } from "../state/api";
import { look, models, refresh, session, sessions, sources } from "../state/store";
import type { Session } from "../types";

interface RecordedFile { file: string; bytes: number }

export function RecordingPanel({ of }: { of: Session }) {
  const path = `/v1/sessions/${segment(of.name)}/recording`;
  const frames = useSignal("raw");
  const fault = useSignal("");
  const now = of.recording;
  const isGoing = now?.state === "recording";
  const act = async (method: "PUT" | "DELETE", body?: unknown) => {
    try {
      await send(method, path, body);
      fault.value = "";
    } catch (error) {
      fault.value = said(error);
    }
    await refresh();
  };
  return (
    <section class="panel" aria-label="recording">
      <h3>Record <small class="quiet">frames and estimates of {of.name}, as MCAP, on the service's machine</small></h3>
      <p class="row">
        {isGoing ? <button class="primary" onClick={() => void act("DELETE")}>End the recording</button> : <button onClick={() => void act("PUT", { frames: frames.value })}>Record</button>}
        {!isGoing && (
          <label>pixels <select value={frames} onChange={(event) => { frames.value = event.currentTarget.value; }}>
            <option value="raw">as they are</option><option value="jpeg">as JPEG</option><option value="none">none</option>
          </select></label>
        )}
        {now && <span>{now.state}: {grouped(now.recorded_frames)} frames, {megabytes(now.bytes)}{now.dropped ? `, ${grouped(now.dropped)} lost` : ""} {now.reason}</span>}
      </p>
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
    </section>
  );
}

function megabytes(bytes: number): string {
  return `${(bytes / 1e6).toFixed(1)} MB`;
}

const listing = newestOnly();

/** The files of all recordings that have ended, newest first; read anew whenever a recording begins or ends. */
export function RecordedFiles() {
  const files = useSignal<RecordedFile[]>([]);
  const chosen = useSignal("");
  const model = chosen.value || (session.value?.active_model ?? "spot");
  const fault = useSignal("");
  const current = sessions.value.map((one) => `${one.recording?.state ?? ""}${one.recording?.files.length ?? 0}`).join();
  useEffect(() => {
    const isNewest = listing();
    get<{ items: RecordedFile[] }>("/v1/recordings").then(
      (found) => { if (isNewest()) files.value = found.items.sort((a, b) => startOf(b.file) - startOf(a.file) || b.file.localeCompare(a.file)); },
      (error) => { if (isNewest()) fault.value = said(error); },
    );
  }, [current]);
  const replay = async (file: string) => {
    try {
      await beginReplay(file, model);
      fault.value = "";
    } catch (error) {
      fault.value = said(error);
    }
  };
  if (files.value.length === 0) return fault.value ? <p class="panel fault" role="alert">{fault.value}</p> : null;
  return (
    <section class="panel" aria-label="recorded">
      <h3>Recorded <small class="quiet">replay: a session of its own, from the first frame on</small></h3>
      <p><label>fit it with <select aria-label="model of the replay" value={model} onChange={(event) => { chosen.value = event.currentTarget.value; }}>
        {models.value.map((one) => <option key={one.name}>{one.name}</option>)}
      </select></label></p>
      <div class="scroll recorded"><table><tbody>
        {files.value.map(({ file, bytes }) => (
          <tr key={file}>
            <th scope="row" class="wrap">{hasToken() ? <code>{file}</code> : <a href={`/v1/recordings/${segment(file)}`} download={file}>{file}</a>}</th>
            <td class="number">{megabytes(bytes)}</td>
            <td><button aria-label={`replay ${file}`} onClick={() => void replay(file)}>Replay</button></td>
          </tr>
        ))}
      </tbody></table></div>
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
    </section>
  );
}

/** Seconds since 1970 as a file's name has them, `demo-7-1795000000-0001.mcap`; 0 where somebody chose the name. */
function startOf(file: string): number {
  return Number(/-(\d{9,})-\d+\.mcap$/.exec(file)?.[1] ?? 0);
}

/** A session of the recording's name, from its first frame on, with that model. */
async function beginReplay(file: string, model: string) {
  const name = file.replace(/\.mcap$/, "").slice(-64).replace(/^-+/, "");
  if (sessions.value.some((one) => one.name === name)) await gone(`/v1/sessions/${segment(name)}`);
  if (sources.value.some((one) => one.name === name)) await gone(`/v1/sources/${segment(name)}`);
  await send("PUT", `/v1/sources/${segment(name)}`, { kind: "recording", path: file, loop: true });
  await send("PUT", `/v1/sessions/${segment(name)}`, { source: name, model });
  await refresh();
  look(name);
}

/** Deletes what may be gone already. */
async function gone(path: string) {
  await send("DELETE", path).catch((error) => { if (!(error instanceof Refused && error.status === 404)) throw error; });
}
