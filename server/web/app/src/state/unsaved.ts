// Edits that are nowhere but on this page: whatever would lose them asks first.
import { effect, signal } from "@preact/signals";

/** The name of the document that has them; empty where there are none. */
export const unsaved = signal("");

function askBeforeUnload(event: BeforeUnloadEvent) {
  event.preventDefault();
}

effect(() => {
  if (unsaved.value) addEventListener("beforeunload", askBeforeUnload);
  else removeEventListener("beforeunload", askBeforeUnload);
});

/** Whether the edits may be lost; true where there are none. */
export function mayDiscard(): boolean {
  return !unsaved.peek() || confirm(`Your edits of ${unsaved.peek()} are not stored. Discard them?`);
}
