// Keeps what a session sees and says, to be fitted again.
import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { grouped } from "../format";
import { Refused, get, hasToken, said, segment, send } from "../state/api";

interface Recording { state: string; reason?: string; files: string[]; recorded_frames: number; bytes: number; dropped: number }

const POLL_MS = 1000;

export function RecordingPanel({ session }: { session: string }) {
  const path = `/v1/sessions/${segment(session)}/recording`;
  const now = useSignal<Recording | null>(null);
  const finished = useSignal<string[]>([]);
  const frames = useSignal("raw");
  const fault = useSignal("");
  const isGoing = now.value?.state === "recording";
  useEffect(() => {
    if (!isGoing) return;
    const timer = setInterval(() => {
      get<Recording>(path).then((found) => { now.value = found; }, (error) => { fault.value = said(error); now.value = null; });
    }, POLL_MS);
    return () => clearInterval(timer);
  }, [isGoing, path]);
  const begin = async () => {
    fault.value = "";
    try {
      now.value = await send<Recording>("PUT", path, { frames: frames.value });
    } catch (error) {
      fault.value = said(error);
      // Perhaps somebody else records it already: that can be seen and ended here.
      if (error instanceof Refused && error.status === 409) now.value = await get<Recording>(path).catch(() => null);
    }
  };
  const end = async () => {
    try {
      const files = now.value?.files ?? [];
      await send("DELETE", path);
      finished.value = files;
      now.value = null;
      fault.value = "";
    } catch (error) {
      fault.value = said(error);
    }
  };
  return (
    <section class="panel" aria-label="recording">
      <h3>Record <small class="quiet">frames and estimates of {session}, as MCAP, on the service's machine</small></h3>
      <p class="row">
        {isGoing ? <button class="primary" onClick={() => void end()}>End the recording</button> : <button onClick={() => void begin()}>Record</button>}
        {!isGoing && (
          <label>pixels <select value={frames} onChange={(event) => { frames.value = event.currentTarget.value; }}>
            <option value="raw">as they are</option><option value="jpeg">as JPEG</option><option value="none">none</option>
          </select></label>
        )}
        {now.value && <span>{now.value.state}: {grouped(now.value.recorded_frames)} frames, {(now.value.bytes / 1e6).toFixed(1)} MB{now.value.dropped ? `, ${grouped(now.value.dropped)} lost` : ""} {now.value.reason}</span>}
      </p>
      {finished.value.length > 0 && (
        <p>{finished.value.map((file) => (hasToken() ? <code key={file}>{file} </code> : <a key={file} href={`/v1/recordings/${segment(file)}`} download={file}>{file} </a>))}</p>
      )}
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
    </section>
  );
}
