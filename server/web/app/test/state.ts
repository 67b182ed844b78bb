// What the page knows is what the service says: answers that come late, recordings, other people's changes, edits that are not stored.
import assert from "node:assert/strict";
import { join } from "node:path";
import type { Page, Route } from "playwright-core";
import { until, type Check } from "./checks.ts";
import { TOP, Visit, folder, json, run, serve, type Service } from "./service.ts";

/** Pictures of a spot, each at another place. */
function spots(places: [number, number][]) {
  const made = folder();
  const files = places.map(([x, y], i) => {
    const into = join(made.path, String(i));
    run(["render", join(TOP, "models/spot.toml"), "--set", `bx=${x},by=${y},a1=0.0011,a2=0,a3=0.0025,v0=20,v1=150`, "--size", "200x160", "--out", into]);
    return join(into, "000000.png");
  });
  return { files, remove: made.remove };
}

/** Holds requests to paths that match until they are let go; the page may have given them up by then. */
async function hold(page: Page, pattern: RegExp) {
  const held: Route[] = [];
  await page.route(pattern, (route) => { held.push(route); });
  return {
    count: () => held.length,
    async release(which: number) { await held[which]!.continue().catch(() => undefined); },
  };
}

/** Whether something of the contour's colour is on the picture that was dropped. */
function isOutlined(page: Page): Promise<boolean> {
  return page.evaluate(() => {
    const canvas = document.querySelector<HTMLCanvasElement>("canvas.image");
    if (!canvas?.width) return false;
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true })!;
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    return data.some((red, i) => i % 4 === 0 && red > 200 && data[i + 1]! > 100 && data[i + 1]! < 190 && data[i + 2]! < 80);
  });
}

function put(service: Service, path: string, document: object): Promise<unknown> {
  return json(`${service.url}${path}`, { method: "PUT", headers: { "content-type": "application/json" }, body: JSON.stringify(document) });
}

async function textOf(service: Service, model: string): Promise<string> {
  return (await fetch(`${service.url}/v1/models/${model}`, { headers: { accept: "application/toml" } })).text();
}

/** Types at the document's end. */
async function edit(page: Page, text: string) {
  await page.locator(".cm-line").first().click();
  await page.keyboard.press("Control+End");
  await page.keyboard.type(text);
}

export const state: Record<string, Check> = {
  async "a picture's result is drawn on no other picture"(browser, service) {
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    const made = spots([[60.5, 78.25], [140.5, 90.25]]);
    await visit.go("sources");
    const panel = page.getByLabel("one image");
    const input = panel.locator("input[type=file]");
    const shown = async () => Number(await panel.locator("tr", { hasText: "bx" }).locator("td").first().textContent());
    await input.setInputFiles(made.files[0]!);
    await until(() => isOutlined(page), "the first picture's outline");
    const requests = await hold(page, /:fit/);
    await input.setInputFiles(made.files[1]!);
    await until(async () => requests.count() === 1, "the second picture is sent");
    await page.waitForFunction(() => !document.querySelector("[aria-label='one image'] table"));
    assert.equal(await isOutlined(page), false, "the first picture's outline is drawn on the second");
    await input.setInputFiles(made.files[0]!);
    await until(async () => requests.count() === 2, "the first picture is sent again");
    await requests.release(1);
    await until(() => isOutlined(page), "the first picture's outline");
    await requests.release(0);
    await page.waitForTimeout(1000); // an answer that is late would be shown by now
    assert.ok(Math.abs(await shown() - 60.5) < 0.2, `bx = ${await shown()}`);
    made.remove();
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "a model that is chosen in mid-fit is the one whose answer is shown"(browser, service) {
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    const made = spots([[60.5, 78.25]]);
    await visit.go("sources");
    const requests = await hold(page, /:fit/);
    const panel = page.getByLabel("one image");
    await panel.locator("input[type=file]").setInputFiles(made.files[0]!);
    await panel.getByLabel("model").selectOption("gaussian");
    await until(async () => requests.count() === 2, "the picture is sent for both models");
    await requests.release(1);
    await panel.locator("tr", { hasText: "bx" }).waitFor();
    const names = () => panel.locator("tr th").allTextContents();
    const ofGaussian = await names();
    await requests.release(0);
    await page.waitForTimeout(1000); // as above
    assert.deepEqual(await names(), ofGaussian);
    const { parameters } = await json<{ parameters: object }>(`${service.url}/v1/models/gaussian`);
    assert.deepEqual([...ofGaussian].sort(), Object.keys(parameters).sort());
    made.remove();
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "a document that is opened late takes the place of no other"(browser, service) {
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    await visit.go("model");
    await page.locator(".said .formulas math").first().waitFor();
    const requests = await hold(page, /models\/ring$/);
    const select = page.getByLabel("open a model");
    await select.selectOption("ring");
    await until(async () => requests.count() === 1, "the first document is asked for");
    await select.selectOption("gaussian");
    await page.locator(".cm-line", { hasText: /^name\s*= "gaussian"/ }).waitFor();
    await requests.release(0);
    await page.waitForTimeout(1000); // as above
    assert.equal(await page.locator(".cm-line", { hasText: /^name\s*= "gaussian"/ }).count(), 1);
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "text that is typed over lines keeps to the page's policy"(browser, service) {
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    await visit.go("model");
    const lines = page.locator(".cm-line");
    const at = lines.filter({ hasText: /^intensity/ });
    await at.waitFor();
    const before = await lines.count();
    const input = await visit.context.newCDPSession(page);
    const ways: [string, () => Promise<unknown>][] = [
      ["a letter", () => page.keyboard.type("q")],
      ["a bracket", () => page.keyboard.type("(")],
      ["an input method", async () => {
        await input.send("Input.imeSetComposition", { text: "あい", selectionStart: 2, selectionEnd: 2 });
        await input.send("Input.insertText", { text: "愛" });
      }],
      ["cutting", () => page.keyboard.press("Control+x")],
      ["Delete", () => page.keyboard.press("Delete")],
    ];
    for (const [what, type] of ways) {
      await at.click();
      await page.keyboard.press("Home");
      for (let i = 0; i < 3; i++) await page.keyboard.press("Shift+ArrowUp");
      await type();
      // Brackets are put around what is selected.
      await until(async () => (await lines.count()) === (what === "a bracket" ? before : before - 3), `${what} takes the place of lines`);
      await page.keyboard.press("Control+z");
      await until(async () => (await lines.count()) === before && (await at.count()) === 1, `${what} is undone`);
    }
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "a recording goes on while nobody looks, and its file is replayed by a click"(browser) {
    const made = folder();
    const service = await serve(["--demo", "--data", made.path]);
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    await visit.go("sources");
    const panel = page.getByLabel("recording", { exact: true });
    const ending = panel.getByRole("button", { name: "End the recording" });
    await panel.getByRole("button", { name: "Record" }).click();
    await ending.waitFor();
    await page.locator("nav a[href='#live']").click();
    await visit.overlaid();
    await page.locator("nav a[href='#sources']").click();
    await ending.waitFor();
    await page.reload();
    await ending.waitFor();
    await panel.locator("span", { hasText: /recording: \d+ frames/ }).waitFor();
    await ending.click();
    const recorded = page.getByLabel("recorded", { exact: true });
    await recorded.getByLabel("model of the replay").selectOption("gaussian");
    await recorded.getByRole("button", { name: "replay" }).click();
    await page.waitForURL(/[?&]session=demo-/);
    await visit.waitForState("tracking|coasting|misfit|searching");
    const name = new URL(page.url()).searchParams.get("session")!;
    assert.match(name, /^demo-/);
    const session = await json<{ active_model: string; source: string; last: { model: string } }>(`${service.url}/v1/sessions/${name}`);
    assert.equal(session.active_model, "gaussian");
    assert.match(session.last.model, /^gaussian@/);
    assert.deepEqual(visit.complaints, []);
    await visit.close();
    await service.stop();
    made.remove();
  },

  async "two people set one scene, and each sees what the other sets"(browser) {
    const service = await serve(["--demo"]);
    const visits = await Promise.all([Visit.open(browser, service), Visit.open(browser, service)]);
    const [first, second] = visits as [Visit, Visit];
    const slider = (visit: Visit, label: string) => visit.page.getByLabel(label, { exact: true });
    for (const visit of visits) {
      await visit.go("sources");
      await slider(visit, "glare").waitFor();
    }
    await slider(first, "glare").focus();
    await first.page.keyboard.press("End");
    await slider(second, "defocus").focus();
    await second.page.keyboard.press("End");
    await slider(first, "movement").focus();
    await first.page.keyboard.press("Home");
    await slider(second, "speed").focus();
    await second.page.keyboard.press("Home");
    interface Scene { light: { glare?: { height: number }[]; defocus_px?: number }; motion: { bx: string } }
    const scene = () => json<Scene>(`${service.url}/v1/sources/demo/scene`);
    await until(async () => (await scene()).motion.bx === "320 + 0*sin(2*pi*0*t)", "both have set the movement");
    const { light } = await scene();
    assert.deepEqual([light.glare?.[0]?.height, light.defocus_px], [250, 12], JSON.stringify(light));
    await until(async () => (await slider(first, "defocus").inputValue()) === "12", "the first one sees the second one's defocus");
    await until(async () => (await slider(second, "glare").inputValue()) === "250", "the second one sees the first one's glare");
    await put(service, "/v1/sources/demo/scene", { read_noise_e: 100 });
    for (const visit of visits) await until(async () => (await slider(visit, "read noise").inputValue()) === "100", "sliders follow the service");
    for (const visit of visits) { assert.deepEqual(visit.complaints, []); await visit.close(); }
    await service.stop();
  },

  async "somebody else's version of a model is shown before it is replaced"(browser) {
    const service = await serve(["--demo"]);
    const visits = await Promise.all([Visit.open(browser, service), Visit.open(browser, service)]);
    const [first, second] = visits as [Visit, Visit];
    for (const visit of visits) {
      await visit.go("model");
      await visit.page.locator(".said .formulas math").first().waitFor();
    }
    await edit(second.page, "\n# theirs");
    await second.page.locator("#apply").click();
    await second.page.locator(".swap", { hasText: "active at frame" }).waitFor();
    await edit(first.page, "\n# mine");
    await first.page.locator("#apply").click();
    const told = first.page.getByLabel("changed by somebody else");
    await told.waitFor();
    assert.match(await textOf(service, "spot"), /# theirs/);
    await told.getByText("See theirs").click();
    assert.match((await told.locator("pre").textContent())!, /# theirs/);
    assert.equal(await first.page.locator(".cm-line", { hasText: "# mine" }).count(), 1, "the draft is still there");
    await told.getByRole("button", { name: "Replace theirs" }).click();
    await until(async () => /# mine/.test(await textOf(service, "spot")), "mine is stored");
    assert.deepEqual(first.complaints.filter((one) => !/412/.test(one)), []);
    for (const visit of visits) await visit.close();
    await service.stop();
  },

  async "a document that the session refuses is not stored, and the history says what is in use"(browser) {
    const service = await serve(["--demo"]);
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    const versions = async (model: string) => (await json<{ items: { version: number }[] }>(`${service.url}/v1/models/${model}/versions`)).items.length;
    const { items } = await json<{ items: { name: string }[] }>(`${service.url}/v1/models`);
    const documents = await Promise.all(items.map(({ name }) => json<{ name: string; channels: string[] }>(`${service.url}/v1/models/${name}`)));
    const coloured = items[documents.findIndex((one) => one.channels.length === 3)]!.name;
    const before = await versions(coloured);
    await visit.go("model");
    await page.locator(".said .formulas math").first().waitFor();
    await page.getByLabel("open a model").selectOption(coloured);
    await page.locator(".cm-line", { hasText: /^channels/ }).waitFor();
    await edit(page, "\n# mine");
    for (const button of ["#apply", "#shadow"]) {
      await page.locator(button).click();
      await page.locator(".said .fault, .faults").first().waitFor();
      assert.equal(await versions(coloured), before, `${button} has stored it`);
    }
    page.once("dialog", (dialog) => void dialog.accept());
    await page.getByLabel("open a model").selectOption("spot");
    const history = page.getByLabel("history");
    await history.locator("tr", { hasText: "in use by demo" }).waitFor();
    const other = (await textOf(service, "spot")).replace("start = -0.5", "start = -0.45");
    await fetch(`${service.url}/v1/models/spot`, { method: "PUT", headers: { "content-type": "application/toml" }, body: other });
    await page.getByLabel("open a model").selectOption("gaussian");
    await history.locator("tr", { hasText: "current, not in use" }).waitFor();
    await page.getByLabel("open a model").selectOption("spot");
    await history.locator("tr", { hasText: "in use by demo" }).waitFor();
    const rows = await history.locator("tr").allTextContents();
    assert.deepEqual(rows.map((row) => /in use by demo/.test(row)), [false, true], rows.join("; "));
    assert.deepEqual(visit.complaints.filter((one) => !/409/.test(one)), []);
    await visit.close();
    await service.stop();
  },

  async "without sessions no view asks for one"(browser) {
    const service = await serve([]);
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    const asked: string[] = [];
    page.on("request", (request) => asked.push(request.url()));
    page.on("websocket", (socket) => asked.push(socket.url()));
    for (const view of ["live", "plots", "model", "explorer", "sources"]) {
      await visit.go(view);
      await page.locator(`nav a[href="#${view}"][aria-current]`).waitFor();
      await page.waitForTimeout(1000); // for requests that follow
    }
    const empty = asked.filter((url) => /\/v1\/[a-z]+\/(\/|\?|$)/.test(url));
    assert.deepEqual(empty, []);
    assert.deepEqual(visit.complaints, []);
    await visit.close();
    await service.stop();
  },

  async "the address names the session"(browser) {
    const service = await serve(["--demo"]);
    await put(service, "/v1/sessions/other", { source: "demo", model: "gaussian" });
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    const name = page.getByLabel("session", { exact: true });
    await visit.go("live");
    await name.selectOption("other");
    await page.locator("nav a[href='#plots']").click();
    await page.locator(".charts canvas").first().waitFor();
    await page.reload();
    await page.locator(".charts canvas").first().waitFor();
    assert.equal(await name.inputValue(), "other");
    const shared = await Visit.open(browser, service);
    await shared.page.goto(page.url());
    await shared.page.locator("nav a[href='#plots'][aria-current]").waitFor();
    await until(async () => (await shared.page.getByLabel("session", { exact: true }).inputValue()) === "other", "a shared address shows the same session");
    await name.selectOption("demo");
    await page.goBack();
    await until(async () => (await name.inputValue()) === "other", "back to the session before");
    await shared.page.goto(`${service.url}/?session=nobody#live`);
    await shared.page.locator(".banner", { hasText: "no session nobody" }).waitFor();
    for (const one of [visit, shared]) { assert.deepEqual(one.complaints, []); await one.close(); }
    await service.stop();
  },

  async "edits that are not stored are asked about before they are lost"(browser, service) {
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    await visit.go("model");
    await page.locator(".said .formulas math").first().waitFor();
    await edit(page, "\n# mine");
    const mine = page.locator(".cm-line", { hasText: "# mine" });
    let asked = 0;
    page.on("dialog", (dialog) => { asked += 1; void dialog.dismiss(); });
    const select = page.getByLabel("open a model");
    const opened = await select.inputValue();
    await select.selectOption("ring");
    assert.deepEqual([asked, await select.inputValue(), await mine.count()], [1, opened, 1], "another document");
    await page.locator("nav a[href='#live']").click();
    await visit.overlaid();
    await page.locator("nav a[href='#model']", { hasText: "•" }).click();
    await edit(page, "");
    await mine.waitFor();
    // The page is gone before its context: an open dialog has crashed Chromium there.
    page.removeAllListeners("dialog");
    const [leaving, closed] = [page.waitForEvent("dialog"), page.waitForEvent("close")];
    await page.close({ runBeforeUnload: true });
    const dialog = await leaving;
    assert.equal(dialog.type(), "beforeunload");
    await dialog.accept();
    await closed;
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "a target that is lost has no current values"(browser) {
    const service = await serve(["--demo"]);
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    await visit.go("live");
    await visit.waitForState("tracking");
    const cell = page.locator(`table.parameters tr:has(th:text-is("bx")) td`).first();
    await until(async () => /\d/.test((await cell.textContent())!), "the centre is shown");
    await put(service, "/v1/sources/demo/scene", { light: { occluders: [{ value: 0 }] } });
    await visit.waitForState("lost|searching");
    await page.locator(".unseen", { hasText: /last seen \d+ s ago/ }).waitFor();
    assert.equal(await cell.textContent(), "–");
    const figure = (name: string) => page.locator(`.figures div:has(dt:text-is("${name}")) dd`).textContent();
    assert.deepEqual(await Promise.all(["confidence", "χ²/ν", "saturated"].map(figure)), ["–", "–", "–"]);
    const { last } = await json<{ last: { parameters: Record<string, number> } }>(`${service.url}/v1/sessions/demo`);
    assert.equal(typeof last.parameters["bx"], "number", "JSON keeps its fields");
    await page.locator("nav a[href='#plots']").click();
    await page.locator(".charts canvas").first().waitFor();
    const waiting = page.waitForEvent("download");
    await page.getByRole("button", { name: "CSV" }).click();
    const stream = await (await waiting).createReadStream();
    let text = "";
    for await (const piece of stream) text += String(piece);
    const [head, ...rows] = text.trim().split("\n").map((line) => line.split(","));
    const [stateAt, bxAt] = [head!.indexOf("state"), head!.indexOf("bx")];
    const lost = rows.filter((row) => /lost|searching/.test(row[stateAt]!));
    assert.ok(lost.length > 0 && lost.every((row) => row[bxAt] === ""), "a gap in the table");
    await put(service, "/v1/sources/demo/scene", { light: {} });
    await page.locator("nav a[href='#live']").click();
    await until(async () => /\d/.test((await cell.textContent())!), "the centre is shown again");
    assert.equal(await page.locator(".unseen").count(), 0);
    assert.deepEqual(visit.complaints, []);
    await visit.close();
    await service.stop();
  },

  async "an unknown address is answered with a page that leads on"(browser, service) {
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    for (const path of ["/nothing", "/v2/sessions/demo?x=1"]) {
      const answer = await page.goto(`${service.url}${path}`);
      assert.equal(answer?.status(), 404, path);
      await page.locator("h1", { hasText: "nothing at this address" }).waitFor();
    }
    await page.getByRole("link", { name: "The page" }).click();
    await visit.overlaid();
    const problem = await fetch(`${service.url}/nothing`);
    assert.equal(problem.headers.get("content-type"), "application/problem+json");
    assert.deepEqual(visit.complaints.filter((one) => !/404/.test(one)), []);
    await visit.close();
  },
};
