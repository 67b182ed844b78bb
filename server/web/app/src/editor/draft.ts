// The document that is being edited, and what the service says of it.
import { batch, effect, signal } from "@preact/signals";
import { Refused, checkDocument, documentText, get, newestOnly, putDocument, said, segment, send, type DocumentText, type ModelUse } from "../state/api";
import { refreshModels, session } from "../state/store";
import { swap } from "../state/swap";
import { mayDiscard, unsaved } from "../state/unsaved";
import type { Diagnostic, Session, StageFigures } from "../types";

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

/** Which version was read or put last: only that one is replaced. */
let base: { name: string; tag: string | null } = { name: "", tag: null };

effect(() => { unsaved.value = draft.text.value !== draft.saved.value ? draft.name.value || "the document" : ""; });

/** What somebody else stored under the draft's name meanwhile; without text where they removed it. */
export const conflict = signal<{ name: string; theirs: DocumentText | null } | null>(null);

/** The last document that was free of faults. */
export const report = signal<Report | null>(null);
export const faults = signal<Diagnostic[]>([]);
export const trouble = signal("");
export const versions = signal<Version[]>([]);

const drafting = newestOnly();

function show(name: string, found: DocumentText) {
  base = { name, tag: found.tag };
  batch(() => {
    draft.name.value = name;
    draft.isToml.value = found.isToml;
    draft.saved.value = found.text;
    draft.text.value = found.text;
    trouble.value = "";
    conflict.value = null;
  });
}

/** Whether it was begun: not where edits would be lost that somebody wants to keep. */
export function open(name: string): boolean {
  if (!mayDiscard()) return false;
  void read(name);
  return true;
}

async function read(name: string) {
  const isNewest = drafting();
  try {
    const found = await documentText(name);
    if (!isNewest()) return;
    show(name, found);
    await readVersions();
  } catch (error) {
    if (isNewest()) trouble.value = said(error);
  }
}

const readingVersions = newestOnly();

export async function readVersions() {
  const isNewest = readingVersions();
  const found = await get<{ items: Version[] }>(`/v1/models/${segment(draft.name.value)}/versions`).catch(() => null); // a name that is new
  if (isNewest()) versions.value = found?.items ?? [];
}

const checking = newestOnly();

/** What is wrong with a document, and otherwise its report; null where that cannot be told, or the document is another one by then. */
export async function check(text: string): Promise<Diagnostic[] | null> {
  const isNewest = checking();
  if (!text) return [];
  try {
    const found = await checkDocument<Report>(text, draft.isToml.peek());
    if (!isNewest()) return null;
    report.value = found;
    faults.value = [];
    trouble.value = "";
    return found.warnings;
  } catch (error) {
    if (!isNewest()) return null;
    if (error instanceof Refused && error.status === 422) {
      faults.value = error.diagnostics;
      trouble.value = error.diagnostics.length ? "" : error.message;
      return error.diagnostics;
    }
    trouble.value = said(error);
    return null;
  }
}

/** The name of a session that could take a model. */
function running(one: Session | undefined): string | undefined {
  return one && one.state !== "stopped" && one.state !== "failed" ? one.name : undefined;
}

/** Puts the document under its name, if the session that is looked at can use it so; whether that was done. */
export async function put(use: ModelUse): Promise<boolean> {
  const isNewest = drafting();
  const name = draft.name.value;
  const text = draft.text.value;
  trouble.value = "";
  try {
    const expected = name === base.name ? base.tag : null;
    const tag = await putDocument(name, { text, isToml: draft.isToml.value, tag: expected }, use, running(session.value));
    if (isNewest()) {
      base = { name, tag };
      draft.saved.value = text;
      conflict.value = null;
    }
    await Promise.all([readVersions(), refreshModels()]);
  } catch (error) {
    await refused(name, error, isNewest);
    return false;
  }
  return true;
}

async function refused(name: string, error: unknown, isNewest: () => boolean) {
  const isStale = error instanceof Refused && error.status === 412;
  const theirs = isStale ? await documentText(name).catch(() => null) : null;
  if (!isNewest()) return;
  if (isStale) {
    conflict.value = { name, theirs };
    await readVersions();
    return;
  }
  if (error instanceof Refused && error.status === 422) faults.value = error.diagnostics;
  trouble.value = said(error);
}

/** Edits what somebody else stored, instead of the draft. */
export function takeTheirs() {
  const found = conflict.value;
  if (found?.theirs && mayDiscard()) show(found.name, found.theirs);
}

/** From now on the draft may replace what was shown of theirs, and nothing newer. */
export function replaceTheirs() {
  const found = conflict.value;
  if (!found) return;
  base = { name: found.name, tag: found.theirs?.tag ?? null };
  conflict.value = null;
}

/** Puts the document under its name, and swaps the session to it. */
export async function apply() {
  const [one, name] = [session.value, draft.name.value];
  if ((await put("swap")) && one) await swap(one.name, name);
}

export async function rollBack(version: number) {
  if (!mayDiscard()) return;
  const isNewest = drafting();
  const name = draft.name.value;
  const one = session.value;
  const user = one?.active_model === name ? running(one) : undefined;
  try {
    const query = user === undefined ? "" : `?swap=${segment(user)}`;
    await send("POST", `/v1/models/${segment(name)}:rollback${query}`, { version }, name === base.name ? base.tag : null);
    await Promise.all([read(name), refreshModels()]);
    if (user !== undefined) await swap(user, name);
  } catch (error) {
    await refused(name, error, isNewest);
  }
}
