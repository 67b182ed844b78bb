// The first row of a table whose values are not current.
import { ago } from "../format";
import { beat, current, newest, unseenFor } from "../state/store";

/** Nothing while the target is seen. */
export function Unseen() {
  void beat.value;
  if (!newest.peek() || current()) return null;
  const seconds = unseenFor();
  return <tr><td class="quiet unseen" colSpan={4}>{seconds === undefined ? "–, not seen since this page looks" : `–, last seen ${ago(seconds)}`}</td></tr>;
}
