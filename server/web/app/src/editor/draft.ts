// The document that is being edited, and what the service says of it.
import { signal } from "@preact/signals";
import { Refused, documentText, get, said, segment, send, sendToml } from "../state/api";
import { refreshModels, session } from "../state/store";
import { swap } from "../state/swap";
import type { Diagnostic, StageFigures } from "../types";

export interface Report {
  digest: string;
  stages: (StageFigures & { condition?: number; condition_saturated?: number })[];
  bound?: { parameters: Record<string, number>; deviation: Record<string, number> };
  warnings: Diagnostic[];
  formulas: string;
}

export interface Version { version: number; digest: string; active: boolean; bytes: number; created_at?: string }

export const draft = {
  /** The name in the registry under which it is put. */
  name: signal(""),
  text: signal(""),
  isToml: signal(true),
  /** As last read or put, so that changes are known. */
  saved: signal(""),
};

/** The last document that was free of faults. */
export const report = signal<Report | null>(null);
export const faults = signal<Diagnostic[]>([]);
export const trouble = signal("");
export const versions = signal<Version[]>([]);

export async function open(name: string) {
  try {
    const { text, isToml } = await documentText(name);
    draft.name.value = name;
    draft.isToml.value = isToml;
    draft.saved.value = text;
    draft.text.value = text;
    trouble.value = "";
    await readVersions();
  } catch (error) {
    trouble.value = said(error);
  }
}

export async function readVersions() {
  try {
    versions.value = (await get<{ items: Version[] }>(`/v1/models/${segment(draft.name.value)}/versions`)).items;
  } catch {
    versions.value = []; // a name that is new
  }
}

/** What is wrong with a document, and otherwise its report; null where that cannot be told. */
export async function check(text: string): Promise<Diagnostic[] | null> {
  if (!text) return [];
  try {
    const found = draft.isToml.peek()
      ? await sendToml<Report>("POST", "/v1/models:check", text)
      : await send<Report>("POST", "/v1/models:check", JSON.parse(text));
    report.value = found;
    faults.value = [];
    trouble.value = "";
    return found?.warnings ?? [];
  } catch (error) {
    if (error instanceof Refused && error.status === 422) {
      faults.value = error.diagnostics;
      trouble.value = error.diagnostics.length ? "" : error.message;
      return error.diagnostics;
    }
    trouble.value = said(error);
    return null;
  }
}

/** Puts the document under its name; whether that was done. */
export async function put(): Promise<boolean> {
  const name = draft.name.value;
  const text = draft.text.value;
  trouble.value = "";
  try {
    const path = `/v1/models/${segment(name)}`;
    if (draft.isToml.value) await sendToml("PUT", path, text);
    else await send("PUT", path, JSON.parse(text));
    draft.saved.value = text;
    await Promise.all([readVersions(), refreshModels()]);
  } catch (error) {
    if (error instanceof Refused && error.status === 422) faults.value = error.diagnostics;
    trouble.value = said(error);
    return false;
  }
  return true;
}

/** Puts the document under its name, and swaps the session to it. */
export async function apply() {
  const one = session.value;
  if ((await put()) && one) await swap(one.name, draft.name.value);
}

export async function rollBack(version: number) {
  const name = draft.name.value;
  try {
    await send("POST", `/v1/models/${segment(name)}:rollback`, { version });
    await open(name);
    const one = session.value;
    if (one?.active_model === name) await swap(one.name, name);
  } catch (error) {
    trouble.value = said(error);
  }
}
