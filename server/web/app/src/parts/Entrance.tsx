// Off loopback a service asks for a token. It is kept until the page is closed, and sent to this service only.
import { useSignal } from "@preact/signals";
import { enter, entrance } from "../state/api";

export function Entrance() {
  const token = useSignal("");
  if (!entrance.value) return null;
  return (
    <form class="entrance" onSubmit={(event) => { event.preventDefault(); enter(token.value); }}>
      <h2>This service asks for a token</h2>
      <label>Token <input id="token" type="password" autocomplete="off" autoFocus value={token} onInput={(event) => { token.value = event.currentTarget.value; }} /></label>
      <button class="primary">Show</button>
      {entrance.value.reason && <p class="fault" role="alert">{entrance.value.reason}</p>}
      <p class="quiet"><code>isophote token new --role view</code> makes one to look with, <code>--role operate</code> one to set things with. It is kept until the page is closed, and sent to this service only.</p>
    </form>
  );
}
