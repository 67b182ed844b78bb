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

async function ask(method: string, path: string, body?: BodyInit, headers: Record<string, string> = {}): Promise<Response> {
  const used = token;
  const authorization: Record<string, string> = token ? { authorization: `Bearer ${token}` } : {};
  const answer = await fetch(path, { method, body, headers: { ...authorization, ...headers } });
  if (answer.ok) return answer;
  const problem = await answer.json().catch(() => ({}));
  const detail: string = problem.detail ?? `${method} ${path}: ${answer.status}`;
  // Of what was asked with an older token nothing is learned.
  if (answer.status === 401 && used === token) entrance.value = { reason: token ? detail : "" };
  throw new Refused(answer.status, detail, problem.diagnostics ?? []);
}

export async function get<T>(path: string): Promise<T> {
  return (await ask("GET", path)).json();
}

export async function send<T>(method: "PUT" | "POST" | "DELETE", path: string, body?: unknown): Promise<T | null> {
  const text = body === undefined ? undefined : JSON.stringify(body);
  const answer = await ask(method, path, text, text === undefined ? {} : { "content-type": "application/json" });
  return answer.status === 204 ? null : answer.json();
}

export async function sendToml<T>(method: "PUT" | "POST", path: string, text: string): Promise<T> {
  return (await ask(method, path, text, { "content-type": "application/toml" })).json();
}

export async function sendImage<T>(path: string, image: Blob): Promise<T> {
  return (await ask("POST", path, image, { "content-type": image.type })).json();
}

/** A model's document as it was written, or as JSON if it was written so. */
export async function documentText(name: string): Promise<{ text: string; isToml: boolean }> {
  const answer = await ask("GET", `/v1/models/${segment(name)}`, undefined, { accept: "application/toml" });
  const isToml = (answer.headers.get("content-type") ?? "").startsWith("application/toml");
  return { text: await answer.text(), isToml };
}

export const segment = encodeURIComponent;

export function said(error: unknown): string {
  return error instanceof Refused ? error.message : "the service does not answer";
}
