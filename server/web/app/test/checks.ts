// What the page must do with a session that runs.
import assert from "node:assert/strict";
import { gzipSync } from "node:zlib";
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import type { Browser } from "playwright-core";
import { TOP, Visit, folder, json, run, type Service } from "./service.ts";

export type Check = (browser: Browser, service: Service) => Promise<string | void>;

interface Seen { frame: number; model: string; dropped: number }

/** Collects a session's estimates, all of them, until told to stop. */
async function follow(visit: Visit, session: string) {
  await visit.page.evaluate((name) => {
    const seen: Seen[] = [];
    const socket = new WebSocket(`ws://${location.host}/v1/sessions/${name}/estimates?mode=all&credit=60000`, ["isophote.v1"]);
    socket.onmessage = (event) => {
      const { frame, model, dropped } = JSON.parse(event.data);
      seen.push({ frame, model, dropped });
    };
    Object.assign(window, { seen });
  }, session);
  return () => visit.page.evaluate(() => (window as unknown as { seen: Seen[] }).seen);
}

export const checks: Record<string, Check> = {
  async "first load to first overlaid frame"(browser, service) {
    const visit = await Visit.open(browser, service, { walk: true });
    const start = performance.now();
    await visit.go("live");
    await visit.overlaid();
    const took = performance.now() - start;
    assert.match(await visit.state(), /tracking/);
    await visit.page.locator(".formula-card math").nth(3).waitFor();
    await visit.page.locator("#close-walk").click();
    await visit.page.reload();
    await visit.overlaid();
    assert.equal(await visit.page.locator(".walk").count(), 0, "the walk is closed for good");
    assert.deepEqual(visit.complaints, []);
    await visit.close();
    return `${Math.round(took)} ms`;
  },

  async "one button swaps live"(browser, service) {
    const visit = await Visit.open(browser, service);
    await visit.go("live");
    await visit.overlaid();
    const seen = await follow(visit, "demo");
    await visit.page.locator("#swap").click();
    await visit.page.locator(".swap b").nth(2).waitFor();
    const since = Number(await visit.page.locator(".swap b").nth(2).textContent());
    assert.match((await visit.page.locator(".swap").textContent()) ?? "", /gaussian .* active at frame/);
    await visit.page.waitForFunction((frame) => (window as unknown as { seen: Seen[] }).seen.some((one) => one.frame > frame + 10), since);
    const around = (await seen()).filter((one) => Math.abs(one.frame - since) <= 10);
    for (const one of around) assert.equal(one.model.startsWith("gaussian@"), one.frame >= since, `frame ${one.frame}`);
    around.slice(1).forEach((one, i) => assert.equal(one.frame - around[i]!.frame, 1 + one.dropped, "frame numbers have no gap"));
    await visit.page.locator("#swap").click();
    await visit.page.waitForFunction(() => /requested spot/.test(document.querySelector(".swap")?.textContent ?? "") && /at frame/.test(document.querySelector(".swap")?.textContent ?? ""));
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "sliders of the synthetic camera, and the estimate follows"(browser, service) {
    const visit = await Visit.open(browser, service);
    await visit.go("sources");
    await visit.overlaid();
    const slide = async (label: string, key: string) => {
      await visit.page.getByLabel(label, { exact: true }).focus();
      await visit.page.keyboard.press(key);
    };
    const last = async () => (await json<{ last: { parameters: Record<string, number> } }>(`${service.url}/v1/sessions/demo`)).last.parameters;
    await slide("movement", "Home");
    await until(async () => Math.abs((await last())["bx"]! - 320) < 1 && Math.abs((await last())["by"]! - 240) < 1, "the target stands still");
    const before = (await last())["v1"]!;
    for (let i = 0; i < 5; i++) await slide("exposure", "ArrowRight");
    await until(async () => (await last())["v1"]! > 1.3 * before, "more light, more brightness");
    await visit.page.getByLabel("cover the lens").check();
    await visit.waitForState("lost|searching");
    await visit.page.getByRole("button", { name: "Reset" }).click();
    await visit.waitForState("tracking");
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "an error is underlined where it is, and its repair is applied"(browser, service) {
    const visit = await Visit.open(browser, service);
    await visit.go("model");
    const line = visit.page.locator(".cm-line", { hasText: /^intensity/ });
    await line.click();
    await visit.page.keyboard.press("End");
    await visit.page.keyboard.press("ArrowLeft");
    await visit.page.keyboard.type(" + v9");
    await visit.page.keyboard.press("Escape");
    const squiggle = visit.page.locator(".cm-lintRange-error");
    await squiggle.waitFor();
    assert.equal(await squiggle.textContent(), "v9");
    const text = (await line.textContent())!;
    const told = (await visit.page.locator(".faults b").first().textContent())!;
    assert.equal(told.split(":")[1], String(text.indexOf("v9") + 1), "the column that is told");
    assert.equal(await visit.page.locator("#apply").isDisabled(), true);
    for (let i = 0; i < 5; i++) await visit.page.keyboard.press("Backspace");
    await visit.page.keyboard.type(" + 0 * v0");
    await visit.page.keyboard.press("Escape");
    await visit.page.waitForFunction(() => document.querySelectorAll(".faults").length === 0 && /\+0/.test(document.querySelector(".said .formulas")?.textContent ?? ""));
    const seen = await follow(visit, "demo");
    await visit.page.waitForFunction(() => (window as unknown as { seen: Seen[] }).seen.length > 5);
    await line.click();
    await visit.page.keyboard.press("Control+Enter");
    await visit.page.locator(".swap", { hasText: "active at frame" }).waitFor();
    const since = Number(await visit.page.locator(".swap b").nth(2).textContent());
    await visit.page.waitForFunction((frame) => (window as unknown as { seen: Seen[] }).seen.some((one) => one.frame > frame + 5), since);
    const all = await seen();
    all.slice(1).forEach((one, i) => assert.equal(one.frame - all[i]!.frame, 1 + one.dropped, "frame numbers have no gap"));
    assert.notEqual(all.find((one) => one.frame < since)?.model, all.at(-1)?.model, "another model");
    await visit.page.getByRole("button", { name: "Roll back" }).first().click();
    await visit.page.waitForFunction(() => !/0 \* v0/.test(document.querySelector(".editor")?.shadowRoot?.textContent ?? "0 * v0"));
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "formula and text point at each other"(browser, service) {
    const visit = await Visit.open(browser, service);
    await visit.go("model");
    const term = visit.page.locator(".said [data-key='model.intensity'] msub").last();
    await term.hover();
    await visit.page.locator(".editor .pointed", { hasText: /^v1$/ }).waitFor();
    await visit.page.locator(".cm-line", { hasText: /^s / }).hover({ position: { x: 62, y: 8 } });
    await visit.page.locator(".said .formulas .pointed").first().waitFor();
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "the explorer's panes are filled for every shipped model"(browser, service) {
    const visit = await Visit.open(browser, service);
    const { items } = await json<{ items: { name: string; digest: string }[] }>(`${service.url}/v1/models`);
    assert.ok(items.length > 20);
    await visit.go("explorer");
    const select = visit.page.locator(".explorer select").first();
    for (const { name, digest } of items) {
      await select.selectOption(name);
      await visit.page.waitForFunction((model) => {
        const panes = [...document.querySelectorAll(".pane .body")];
        const isShown = document.querySelector<HTMLElement>(".explorer")?.dataset["shown"] === model;
        return isShown && panes.length === 6 && panes.every((pane) => (pane.textContent ?? "").length > 20) && document.querySelectorAll(".costs").length === 2;
      }, digest, { timeout: 120_000 });
      assert.equal(await visit.page.locator(".explorer .fault").count(), 0, name);
    }
    await select.selectOption("thesis-spot");
    const thesis = items.find((one) => one.name === "thesis-spot")?.digest;
    await visit.page.locator(`.explorer[data-shown="${thesis}"]`).waitFor();
    await visit.page.locator("[data-pane=formulas] [data-key='definitions.s'] msup").first().hover();
    for (const pane of ["formulas", "program", "clif", "asm"]) {
      assert.ok(await visit.page.locator(`[data-pane=${pane}] .pointed`).count() > 0, `nothing is marked in ${pane}`);
    }
    await visit.page.locator("[data-pane=asm] [data-value][data-span]").nth(20).hover();
    assert.ok(await visit.page.locator("[data-pane=program] .pointed").count() > 0, "machine code points back");
    assert.deepEqual(visit.complaints, []);
    await visit.close();
    return `${items.length} models`;
  },

  async "two pages at once"(browser, service) {
    const visits = await Promise.all([Visit.open(browser, service), Visit.open(browser, service)]);
    await Promise.all(visits.map(async (visit) => { await visit.go("live"); await visit.overlaid(); }));
    const frames = () => Promise.all(visits.map(async (visit) => Number((await visit.page.locator(".figures dd").first().textContent())?.replace(/\D/g, ""))));
    const first = await frames();
    await until(async () => (await frames()).every((frame, i) => frame > first[i]! + 10), "both go on");
    for (const visit of visits) { assert.deepEqual(visit.complaints, []); await visit.close(); }
  },

  async "space pauses, arrows step"(browser, service) {
    const visit = await Visit.open(browser, service);
    await visit.go("live");
    await visit.overlaid();
    await visit.page.waitForTimeout(1000); // some frames to step back through
    await visit.page.keyboard.press("Space");
    const told = visit.page.locator(".over.top");
    await told.waitFor();
    const frame = async () => Number(/frame (\d+)/.exec((await told.textContent()) ?? "")?.[1]);
    const at = await frame();
    await visit.page.keyboard.press("ArrowLeft");
    await visit.page.keyboard.press("ArrowLeft");
    await until(async () => (await frame()) < at, "an older frame");
    await visit.page.keyboard.press("ArrowRight");
    await visit.page.keyboard.press("Space");
    await told.waitFor({ state: "detached" });
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "an image of one's own is fitted"(browser, service) {
    const visit = await Visit.open(browser, service);
    const made = folder();
    run(["render", join(TOP, "models/spot.toml"), "--set", "bx=101.5,by=78.25,a1=0.0011,a2=0,a3=0.0025,v0=20,v1=150", "--size", "200x160", "--out", made.path]);
    await visit.go("sources");
    await visit.page.getByLabel("one image").locator("input[type=file]").setInputFiles(join(made.path, "000000.png"));
    const row = visit.page.getByLabel("one image").locator("tr", { hasText: "bx" });
    await row.waitFor();
    assert.ok(Math.abs(Number(await row.locator("td").first().textContent()) - 101.5) < 0.2);
    made.remove();
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "the page is small"() {
    const top = join(TOP, "server/web/dist");
    const files = readdirSync(top, { recursive: true, withFileTypes: true }).filter((entry) => entry.isFile());
    const bytes = files.reduce((sum, entry) => sum + gzipSync(readFileSync(join(entry.parentPath, entry.name)), { level: 9 }).length, 0);
    assert.ok(bytes <= 250 * 1024, `${bytes} bytes`);
    return `${(bytes / 1024).toFixed(0)} KiB compressed, in ${files.length} files`;
  },
};

/** Waits for a condition that is asked for again and again. */
export async function until(holds: () => Promise<boolean>, what: string) {
  const end = performance.now() + 30_000;
  while (!(await holds())) {
    if (performance.now() > end) throw new Error(`waited in vain: ${what}`);
    await new Promise((done) => setTimeout(done, 100));
  }
}
