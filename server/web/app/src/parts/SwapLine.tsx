// Requested → active at frame N.
import { plain } from "../format";
import { swapNews } from "../state/swap";
import { session } from "../state/store";

export function SwapLine() {
  const news = swapNews.value;
  const one = session.value;
  if (news?.fault) return <p class="swap fault" role="alert">{news.requested}: {news.fault}</p>;
  if (news?.isWaiting) return <p class="swap" role="status">requested <b>{news.requested}</b> → compiling; <b>{one?.active_model}</b> goes on …</p>;
  if (news?.answer) {
    const { requested_model, active_model, active_since_frame, carried, reset, compile_ms } = news.answer;
    const anew = reset.length ? `, ${reset.join(" ")} anew` : "";
    return (
      <p class="swap" role="status">
        requested <b>{requested_model}</b> → <b>{active_model}</b> active at frame <b>{active_since_frame}</b>
        <span class="quiet"> · compiled in {plain(compile_ms, 2)} ms · {carried.length} parameters carried over{anew}</span>
      </p>
    );
  }
  if (one && one.requested_model !== one.active_model) {
    return <p class="swap" role="status">requested <b>{one.requested_model}</b>, active <b>{one.active_model}</b></p>;
  }
  return null;
}
