// What this service can do beyond the first of them: read from its own description, once, when a view asks.
import { signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { get } from "./api";

interface Description { paths: Record<string, Record<string, { parameters?: { name: string }[] }>> }

export const features = signal({ recording: false, shadow: false, trace: false });
let isAsked = false;

export function useFeatures() {
  useEffect(() => {
    if (isAsked) return;
    isAsked = true;
    get<Description>("/openapi.json").then(({ paths }) => {
      const session = "/v1/sessions/{name}";
      features.value = {
        recording: Boolean(paths[`${session}/recording`]),
        shadow: Boolean(paths[`${session}/shadow`]?.["get"]),
        trace: paths[`${session}/estimates`]?.["get"]?.parameters?.some((one) => one.name === "trace") ?? false,
      };
    }, () => { isAsked = false; });
  }, []);
}
