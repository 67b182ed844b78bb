// The program, started for a test, and a browser.
import { spawn, spawnSync, type ChildProcess } from "node:child_process";
import { existsSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { chromium, type Browser, type BrowserContext, type Page } from "playwright-core";

/** npm runs scripts where their package.json is. */
export const TOP = resolve("../../..");
const PROGRAM = process.env["ISOPHOTE"] ?? resolve(TOP, process.env["CARGO_TARGET_DIR"] ?? "target", "debug/isophote");
const BROWSERS = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];

/** Where pictures and files of a run go. */
export const OUT = join(TOP, "out/page");
export const DOCS = join(TOP, "docs/figures/page");

export interface Service { url: string; /** Of what was started here. */ pid?: number; stop(): Promise<void> }

/** Starts the program and waits until it says where it listens. */
export function serve(args: string[], address = "127.0.0.1:0"): Promise<Service> {
  return listening(spawn(PROGRAM, ["serve", "--listen", address, ...args], { stdio: ["ignore", "ignore", "pipe"] }));
}

/** The small virtual machine with cameras, beside the repository; it needs root. */
const RIG = resolve(TOP, "../shared/v4l-rig/run.sh");

export const hasRig = existsSync(RIG) && process.getuid?.() === 0;

/** The same on that machine, whose `port` is this one's. */
export function serveInRig(args: string[], port: number): Promise<Service> {
  const env = { ...process.env, V4L_RIG_FORWARD: `${port}:${port}`, V4L_RIG_TIMEOUT: "110", V4L_RIG_QUIET: "1" };
  const address = `127.0.0.1:${port}`;
  return listening(spawn(RIG, [PROGRAM, "serve", "--listen", address, ...args], { env, stdio: ["ignore", "ignore", "pipe"] }));
}

function listening(started: ChildProcess): Promise<Service> {
  return new Promise((done, failed) => {
    let said = "";
    started.on("error", failed);
    started.on("exit", (code) => failed(new Error(`the service ended with ${code}: ${said}`)));
    started.stderr!.on("data", (bytes: Buffer) => {
      said = (said + bytes.toString()).slice(-4000);
      const url = /listening on (http:\/\/\S+)/.exec(said)?.[1];
      if (!url) return;
      started.removeAllListeners("exit");
      started.stderr!.removeAllListeners("data").resume(); // what it says later is nobody's
      done({
        url,
        pid: started.pid,
        stop: () => new Promise((ended) => {
          started.on("exit", () => ended());
          started.kill("SIGTERM");
        }),
      });
    });
  });
}

/** Runs a command of the program; what it printed. */
export function run(args: string[]): string {
  const ended = spawnSync(PROGRAM, args, { encoding: "utf8" });
  if (ended.status !== 0) throw new Error(`isophote ${args.join(" ")}: ${ended.stderr}`);
  return ended.stdout;
}

export function folder(): { path: string; remove(): void } {
  const path = mkdtempSync(join(tmpdir(), "isophote-page-"));
  return { path, remove: () => rmSync(path, { recursive: true, force: true }) };
}

export async function json<T>(url: string, init?: RequestInit): Promise<T> {
  const answer = await fetch(url, init);
  if (!answer.ok) throw new Error(`${url}: ${answer.status} ${await answer.text()}`);
  return answer.json() as Promise<T>;
}

export function browserPath(): string | undefined {
  return BROWSERS.find((path) => existsSync(path));
}

export function launch(): Promise<Browser> {
  return chromium.launch({ executablePath: browserPath()!, args: ["--no-sandbox"] });
}

/** A page that nobody has seen, and what it must not do: ask others, or complain. */
export class Visit {
  readonly complaints: string[] = [];

  private constructor(readonly context: BrowserContext, readonly page: Page, private readonly origin: string) {}

  static async open(browser: Browser, service: Service, look: { width?: number; height?: number; scheme?: "light" | "dark"; walk?: boolean } = {}): Promise<Visit> {
    const { width = 1440, height = 900, scheme = "light", walk = false } = look;
    const context = await browser.newContext({ viewport: { width, height }, colorScheme: scheme });
    if (!walk) await context.addInitScript(() => localStorage.setItem("isophote.walk", "closed"));
    const visit = new Visit(context, await context.newPage(), service.url);
    visit.page.on("console", (message) => { if (["error", "warning"].includes(message.type())) visit.complain(message.text()); });
    visit.page.on("pageerror", (error) => visit.complaints.push(error.message));
    const inside = [service.url, service.url.replace("http", "ws"), "data:", "blob:"];
    const ask = (url: string) => { if (!inside.some((start) => url.startsWith(start))) visit.complaints.push(`asks ${url}`); };
    visit.page.on("request", (request) => ask(request.url()));
    visit.page.on("websocket", (socket) => ask(socket.url()));
    return visit;
  }

  /** The browser tells of every refusal; that a document was refused is no fault of the page's. */
  private complain(text: string) {
    if (!/status of 422/.test(text)) this.complaints.push(text);
  }

  async go(view: string) {
    await this.page.goto(`${this.origin}/#${view}`);
  }

  /** Waits until the camera's picture has something of the contour's colour on it. */
  async overlaid() {
    await this.page.waitForFunction(() => {
      const canvas = document.querySelector<HTMLCanvasElement>(".screen canvas");
      if (!canvas?.width) return false;
      // A copy, so that the page's own canvas stays as it is.
      const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true })!;
      copy.drawImage(canvas, 0, 0);
      const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
      let orange = 0;
      for (let i = 0; i < data.length; i += 4) {
        if (data[i]! > 230 && data[i + 1]! > 120 && data[i + 1]! < 190 && data[i + 2]! < 80) orange += 1;
      }
      return orange > 60;
    }, undefined, { timeout: 30_000, polling: 50 });
  }

  /** A parameter as the table shows it. */
  async parameter(name: string): Promise<number> {
    const cell = this.page.locator(`table.parameters tr:has(th:text-is("${name}")) td`).first();
    return Number((await cell.textContent())?.replace("\u2212", "-"));
  }

  async state(): Promise<string> {
    return (await this.page.locator("header .chip").textContent()) ?? "";
  }

  async waitForState(pattern: string) {
    await this.page.waitForFunction((wanted) => new RegExp(wanted).test(document.querySelector("header .chip")?.textContent ?? ""), pattern, { timeout: 30_000 });
  }

  async close() {
    await this.context.close();
  }
}
