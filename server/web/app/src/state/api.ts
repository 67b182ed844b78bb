// Requests to the service that this page came from, and to nobody else.
import { signal } from "@preact/signals";
import type { Diagnostic } from "../types";

/** Kept until the page is closed: neither in the address nor in the browser's storage. */
let token = "";

/** Whether the service asks for a token, and why the last one did not do. */
export const entrance = signal<{ reason: string } | null>(null);
/** Counts tokens that were given: sockets that were refused try again. */
export const entered = signal(0);

/** An answer that says no. */
export class Refused extends Error {
  constructor(readonly status: number, detail: string, readonly diagnostics: Diagnostic[]) {
    super(detail);
  }
}

export function enter(given: string) {
  token = given.trim();
  entrance.value = null;
  entered.value += 1;
}

export function hasToken(): boolean {
  return token !== "";
}

/** A page can set no other header of a socket. */
export function protocols(): string[] {
  return token ? ["isophote.v1", `isophote.token.${token}`] : ["isophote.v1"];
}

interface Asked { body?: BodyInit; headers?: Record<string, string>; signal?: AbortSignal }

async function ask(method: string, path: string, { body, headers, signal }: Asked = {}): Promise<Response> {
  const used = token;
  const authorization: Record<string, string> = token ? { authorization: `Bearer ${token}` } : {};
  const answer = await fetch(path, { method, body, signal, cache: "no-store", headers: { ...authorization, ...headers } });
  if (answer.ok) return answer;
  const problem = await answer.json().catch(() => ({}));
  const detail: string = problem.detail ?? `${method} ${path}: ${answer.status}`;
  // Of what was asked with an older token nothing is learned.
  if (answer.status === 401 && used === token) entrance.value = { reason: token ? detail : "" };
  throw new Refused(answer.status, detail, problem.diagnostics ?? []);
}

export async function get<T>(path: string, signal?: AbortSignal): Promise<T> {
  return (await ask("GET", path, { signal })).json();
}

/** What was read, and the tag of that version, for `If-Match`; no tag where the route has none. */
export interface Tagged<T> { value: T; tag: string | null }

export async function getTagged<T>(path: string): Promise<Tagged<T>> {
  const answer = await ask("GET", path);
  return { value: await answer.json(), tag: answer.headers.get("etag") };
}

/** With a tag only that version is changed: 412 where somebody else was faster. */
export async function send<T>(method: "PUT" | "POST" | "DELETE", path: string, body?: unknown, tag: string | null = null): Promise<T | null> {
  const text = body === undefined ? undefined : JSON.stringify(body);
  const type: Record<string, string> = text === undefined ? {} : { "content-type": "application/json" };
  const answer = await ask(method, path, { body: text, headers: { ...type, ...ifMatch(tag) } });
  return answer.status === 204 ? null : answer.json();
}

export async function sendImage<T>(path: string, image: Blob, signal: AbortSignal): Promise<T> {
  return (await ask("POST", path, { body: image, headers: { "content-type": image.type }, signal })).json();
}

function ifMatch(tag: string | null): Record<string, string> {
  return tag === null ? {} : { "if-match": tag };
}

/** A model's document as it was written, or as JSON if it was written so. */
export interface DocumentText { text: string; isToml: boolean; tag: string | null }

export async function documentText(name: string): Promise<DocumentText> {
  const answer = await ask("GET", `/v1/models/${segment(name)}`, { headers: { accept: "application/toml" } });
  const isToml = (answer.headers.get("content-type") ?? "").startsWith("application/toml");
  return { text: await answer.text(), isToml, tag: answer.headers.get("etag") };
}

export async function checkDocument<T>(text: string, isToml: boolean): Promise<T> {
  return (await ask("POST", "/v1/models:check", documentBody(text, isToml))).json();
}

/** How a session is to use a model: fit it, or fit it beside its own. */
export type ModelUse = "swap" | "shadow";

/**
 * Stores a document if its name still means the version of `tag`, or nothing where that is null, and if `session` can use it so;
 * the new version's tag.
 */
export async function putDocument(name: string, { text, isToml, tag }: DocumentText, use: ModelUse, session: string | undefined): Promise<string | null> {
  const { body, headers } = documentBody(text, isToml);
  const expected = tag === null ? { "if-none-match": "*" } : ifMatch(tag);
  const query = session === undefined ? "" : `?${use}=${segment(session)}`;
  const answer = await ask("PUT", `/v1/models/${segment(name)}${query}`, { body, headers: { ...headers, ...expected } });
  return answer.headers.get("etag");
}

function documentBody(text: string, isToml: boolean) {
  return { body: text, headers: { "content-type": isToml ? "application/toml" : "application/json" } };
}

/** Of requests of one kind only the newest one's answer counts: asks whether that still is the one begun last. */
export function newestOnly(): () => () => boolean {
  let count = 0;
  return () => {
    const own = ++count;
    return () => own === count;
  };
}

export const segment = encodeURIComponent;

export function said(error: unknown): string {
  return error instanceof Refused ? error.message : "the service does not answer";
}
