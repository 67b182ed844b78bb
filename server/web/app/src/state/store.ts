// What the page knows: sessions, the one that is looked at, its newest estimate and the last thousands of them.
import { computed, effect, signal } from "@preact/signals";
import { entered, entrance, get, newestOnly, protocols, said, segment } from "./api";
import { stream, type Stream } from "./stream";
import type { Estimate, ModelDocument, ModelItem, Session, Source } from "../types";

const POLL_MS = 1000;
/** From one look at what came in to the next. */
const BEAT_MS = 200;
const SESSION_KEY = "session";
/** Estimates that are kept for plots and tables: some minutes. */
export const HISTORY = 6000;

export const sessions = signal<Session[]>([]);
export const sources = signal<Source[]>([]);
export const models = signal<ModelItem[]>([]);
/** Whether the service answers, and what it said last. */
export const service = signal<{ state: "connecting" | "there" | "away"; reason: string }>({ state: "connecting", reason: "" });
export const chosen = signal("");
/** The session that the address names, where there is none of that name. */
export const missing = signal("");
export const target = signal("0");
export const paused = signal(false);

export const session = computed(() => sessions.value.find((one) => one.name === chosen.value));
/** The newest estimate of the target looked at, as it comes; painted at most ten times a second by who shows numbers. */
export const newest = signal<Estimate | null>(null);
/** The last estimate in which the target looked at was seen; null before the first one. */
export const lastSeen = signal<Estimate | null>(null);
/** Estimates of all targets in the newest frame. */
export const targets = signal<string[]>(["0"]);
/** Counts what came in, a few times a second: plots and tables follow it. */
export const beat = signal(0);

/** The last estimates of the target looked at, oldest first. */
export const history: Estimate[] = [];
/** The newest estimate of each. */
let perTarget = new Map<string, Estimate>();
let estimates: Stream | null = null;

/** The active model's document; absent until it is read. */
export const document_ = signal<ModelDocument | null>(null);

function receive(data: string | ArrayBuffer) {
  if (typeof data !== "string") return;
  const message = JSON.parse(data) as Estimate & { targets?: Estimate[] };
  const all = message.targets ? message.targets.map((one) => ({ ...message, ...one, targets: undefined })) : [message];
  for (const one of all) {
    perTarget.set(one.target, one);
    if (one.target !== target.value) continue;
    const last = history[history.length - 1];
    if (last && last.epoch !== one.epoch) history.length = 0;
    history.push(one);
    if (history.length > HISTORY) history.splice(0, HISTORY / 10);
    if (one.state === "tracking") lastSeen.value = one;
    newest.value = one;
  }
}

let waiting: (() => void)[] = [];

function nextBeat(): Promise<void> {
  return new Promise((done) => waiting.push(done));
}

function forget() {
  history.length = 0;
  newest.value = null;
  lastSeen.value = null;
}

function follow(name: string) {
  estimates?.close();
  estimates = null;
  perTarget = new Map();
  forget();
  if (!name) return;
  // Credit comes back with the next beat: however fast a session is, the page hears of so many estimates a second, and of fewer where
  // it is hidden.
  const path = () => `/v1/sessions/${segment(name)}/estimates?mode=latest&credit=8`;
  estimates = stream(path, protocols(), { message: (data) => { receive(data); return nextBeat(); } });
}

const refreshing = newestOnly();

export async function refresh() {
  const isNewest = refreshing();
  try {
    const [found, known] = await Promise.all([
      get<{ items: Session[] }>("/v1/sessions"),
      get<{ items: Source[] }>("/v1/sources"),
    ]);
    if (!isNewest()) return;
    sessions.value = found.items;
    sources.value = known.items;
    service.value = { state: "there", reason: "" };
    choose(found.items);
  } catch (error) {
    if (isNewest()) service.value = { state: "away", reason: said(error) };
  }
}

/** What an answer says of a source; a look at all of them that is under way is older, and counts no more. */
export function learn(name: string, view: Record<string, unknown>) {
  refreshing();
  sources.value = sources.value.map((one) => (one.name === name ? { ...one, ...view } : one));
}

/** The session that the address names; else the one looked at, or one that runs. */
function choose(all: Session[]) {
  const isThere = (name: string) => all.some((one) => one.name === name);
  const asked = new URL(location.href).searchParams.get(SESSION_KEY) ?? "";
  missing.value = asked && all.length > 0 && !isThere(asked) ? asked : "";
  const kept = [asked, chosen.peek()].find(isThere);
  show(kept ?? (all.find((one) => one.state === "running") ?? all[0])?.name ?? "");
  if (!asked && chosen.peek()) window.history.replaceState(null, "", addressOf(chosen.peek()));
}

function addressOf(name: string): URL {
  const address = new URL(location.href);
  address.searchParams.set(SESSION_KEY, name);
  return address;
}

export async function refreshModels() {
  try {
    models.value = (await get<{ items: ModelItem[] }>("/v1/models")).items;
  } catch { /* the poll of sessions says that the service is away */ }
}

const readingDocument = newestOnly();

async function readDocument(name: string) {
  const isNewest = readingDocument();
  const found = await get<ModelDocument>(`/v1/models/${segment(name)}`).catch(() => null);
  if (isNewest()) document_.value = found;
}

/** Starts everything; called once. */
export function begin() {
  effect(() => { void entered.value; follow(chosen.value); });
  effect(() => { void target.value; forget(); });
  const active = computed(() => `${session.value?.active_model ?? ""} ${session.value?.active_digest ?? ""}`);
  effect(() => {
    const name = active.value.split(" ")[0];
    if (name) void readDocument(name);
  });
  effect(() => { void entered.value; void refresh(); void refreshModels(); });
  addEventListener("popstate", () => choose(sessions.peek()));
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

function show(name: string) {
  if (name === chosen.peek()) return;
  target.value = "0";
  chosen.value = name;
}

/** Looks at a session; its name stands in the address, so that a reload and a shared link show the same. */
export function look(name: string) {
  missing.value = "";
  show(name);
  const address = addressOf(name);
  if (address.href !== location.href) window.history.pushState(null, "", address);
}

/** Seconds on the source's clock. */
export function timeOf(estimate: Estimate): number {
  return estimate.capture_ns === undefined ? estimate.time_s ?? estimate.frame / (session.peek()?.rate_hz || 30) : estimate.capture_ns / 1e9;
}

/** Whether an estimate says where its target is in that frame: measured, or predicted from how it moved. */
export function hasPlace(estimate: Estimate): boolean {
  return estimate.state === "tracking" || estimate.state === "coasting";
}

/** Of several targets one that is gone is not reported any more: after so many seconds its last estimate is old. */
const GONE_S = 1;

function lag(estimate: Estimate): number {
  return Math.max(...[...perTarget.values()].map(timeOf)) - timeOf(estimate);
}

/** The newest estimate, if it says where the target is now; null while the target is lost. */
export function current(): Estimate | null {
  const estimate = newest.peek();
  return estimate && hasPlace(estimate) && lag(estimate) <= GONE_S ? estimate : null;
}

/** Seconds since the target was last seen; undefined where the page has not seen it. */
export function unseenFor(): number | undefined {
  const last = lastSeen.peek();
  return last ? lag(last) : undefined;
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
