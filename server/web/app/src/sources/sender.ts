// Changes of a slider on their way: the newest of each name wins, one request at a time.
import type { Signal } from "@preact/signals";
import { useRef } from "preact/hooks";
import { said } from "../state/api";

export type Change = Record<string, unknown>;

/** Sends what is changed by `put`; what went wrong last stands in `fault`. */
export function useSender(put: (change: Change) => Promise<void>, fault: Signal<string>): (change: Change) => Promise<void> {
  const waiting = useRef<Change | null>(null);
  const isSending = useRef(false);
  return async (change) => {
    waiting.current = { ...waiting.current, ...change };
    if (isSending.current) return;
    isSending.current = true;
    while (waiting.current) {
      const next = waiting.current;
      waiting.current = null;
      try {
        await put(next);
        fault.value = "";
      } catch (error) {
        fault.value = said(error);
      }
    }
    isSending.current = false;
  };
}
