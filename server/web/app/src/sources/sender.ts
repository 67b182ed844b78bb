// Changes of a slider on their way: the newest of each name wins, one request at a time.
import type { Signal } from "@preact/signals";
import { useRef } from "preact/hooks";
import { said } from "../state/api";

/** Sends what is changed by `put`; what went wrong last stands in `fault`. Answers true to the last change of a row, when all are sent. */
export function useSender<T extends object>(put: (change: T) => Promise<void>, fault: Signal<string>): (change: T) => Promise<boolean> {
  const waiting = useRef<T | null>(null);
  const isSending = useRef(false);
  return async (change) => {
    waiting.current = { ...waiting.current, ...change };
    if (isSending.current) return false;
    isSending.current = true;
    while (waiting.current) {
      const next: T = waiting.current;
      waiting.current = null;
      try {
        await put(next);
        fault.value = "";
      } catch (error) {
        fault.value = said(error);
      }
    }
    isSending.current = false;
    return true;
  };
}
