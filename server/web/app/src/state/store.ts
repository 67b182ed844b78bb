// What the page knows: sessions, the one that is looked at, its newest estimate and the last thousands of them.
import { computed, effect, signal } from "@preact/signals";
import { entered, entrance, get, protocols, said, segment } from "./api";
import { stream, type Stream } from "./stream";
import type { Estimate, ModelDocument, ModelItem, Session, Source } from "../types";

const POLL_MS = 1000;
/** From one look at what came in to the next. */
const BEAT_MS = 200;
/** Estimates that are kept for plots and tables: some minutes. */
export const HISTORY = 6000;

export const sessions = signal<Session[]>([]);
export const sources = signal<Source[]>([]);
export const models = signal<ModelItem[]>([]);
/** Whether the service answers, and what it said last. */
export const service = signal<{ state: "connecting" | "there" | "away"; reason: string }>({ state: "connecting", reason: "" });
export const chosen = signal("");
export const target = signal("0");
export const paused = signal(false);

export const session = computed(() => sessions.value.find((one) => one.name === chosen.value));
/** The newest estimate of the target looked at, as it comes; painted at most ten times a second by who shows numbers. */
export const newest = signal<Estimate | null>(null);
/** Estimates of all targets in the newest frame. */
export const targets = signal<string[]>(["0"]);
/** Counts what came in, a few times a second: plots and tables follow it. */
export const beat = signal(0);

/** The last estimates of the target looked at, oldest first. */
export const history: Estimate[] = [];
let perTarget = new Map<string, number>();
let estimates: Stream | null = null;

/** The active model's document; absent until it is read. */
export const document_ = signal<ModelDocument | null>(null);

function receive(data: string | ArrayBuffer) {
  if (typeof data !== "string") return;
  const message = JSON.parse(data) as Estimate & { targets?: Estimate[] };
  const all = message.targets ? message.targets.map((one) => ({ ...message, ...one, targets: undefined })) : [message];
  for (const one of all) {
    perTarget.set(one.target, one.frame);
    if (one.target !== target.value) continue;
    const last = history[history.length - 1];
    if (last && last.epoch !== one.epoch) history.length = 0;
    history.push(one);
    if (history.length > HISTORY) history.splice(0, HISTORY / 10);
    newest.value = one;
  }
}

let waiting: (() => void)[] = [];

function nextBeat(): Promise<void> {
  return new Promise((done) => waiting.push(done));
}

function follow(name: string) {
  estimates?.close();
  estimates = null;
  history.length = 0;
  perTarget = new Map();
  newest.value = null;
  if (!name) return;
  // Credit comes back with the next beat: however fast a session is, the page hears of so many estimates a second, and of fewer where
  // it is hidden.
  const path = () => `/v1/sessions/${segment(name)}/estimates?mode=latest&credit=8`;
  estimates = stream(path, protocols(), { message: (data) => { receive(data); return nextBeat(); } });
}

export async function refresh() {
  try {
    const [found, known] = await Promise.all([
      get<{ items: Session[] }>("/v1/sessions"),
      get<{ items: Source[] }>("/v1/sources"),
    ]);
    sessions.value = found.items;
    sources.value = known.items;
    service.value = { state: "there", reason: "" };
    if (!found.items.some((one) => one.name === chosen.value)) {
      const wanted = found.items.find((one) => one.state === "running") ?? found.items[0];
      chosen.value = wanted?.name ?? "";
    }
  } catch (error) {
    service.value = { state: "away", reason: said(error) };
  }
}

export async function refreshModels() {
  try {
    models.value = (await get<{ items: ModelItem[] }>("/v1/models")).items;
  } catch { /* the poll of sessions says that the service is away */ }
}

async function readDocument(name: string) {
  try {
    document_.value = await get<ModelDocument>(`/v1/models/${segment(name)}`);
  } catch {
    document_.value = null;
  }
}

/** Starts everything; called once. */
export function begin() {
  effect(() => { void entered.value; follow(chosen.value); });
  const active = computed(() => `${session.value?.active_model ?? ""} ${session.value?.active_digest ?? ""}`);
  effect(() => {
    const name = active.value.split(" ")[0];
    if (name) void readDocument(name);
  });
  effect(() => { void entered.value; void refresh(); void refreshModels(); });
  // One after the other, so that a slow link is not filled with questions.
  const poll = async () => {
    if (!entrance.peek()) await refresh();
    setTimeout(poll, POLL_MS);
  };
  setTimeout(poll, POLL_MS);
  setInterval(() => {
    const seen = [...perTarget.keys()].sort((a, b) => Number(a) - Number(b));
    if (seen.join() !== targets.peek().join() && seen.length > 0) targets.value = seen;
    waiting.splice(0).forEach((done) => done());
    if (!document.hidden && !paused.peek()) beat.value += 1;
  }, BEAT_MS);
}

export function look(name: string) {
  target.value = "0";
  chosen.value = name;
}

/** The parameters that have the role `centre`, of a document with one target or of its first. */
export function centreOf(document: ModelDocument | null): string[] {
  const roles = document?.roles ?? {};
  const own = roles["centre"];
  if (Array.isArray(own)) return own as string[];
  for (const nested of Object.values(roles)) {
    const inner = (nested as { centre?: string[] } | null)?.centre;
    if (Array.isArray(inner)) return inner;
  }
  return [];
}
