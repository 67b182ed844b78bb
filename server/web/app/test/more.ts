// Tokens, hostile text, a service that goes away, and what the page costs.
import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { until, type Check } from "./checks.ts";
import { slowed } from "./slow.ts";
import { Visit, folder, json, run, serve } from "./service.ts";

const MARKUP = "<img src=x onerror=alert(1)><script>alert(2)</script>";

export const more: Record<string, Check> = {
  async "a token is asked for, and kept nowhere"(browser) {
    const made = folder();
    const token = run(["token", "new", "--role", "operate", "--name", "page", "--data", made.path]).trim();
    const guarded = await serve(["--demo", "--require-token", "--data", made.path]);
    const visit = await Visit.open(browser, guarded);
    await visit.go("live");
    const field = visit.page.locator("#token");
    await field.fill(`isophote_${"0".repeat(64)}`);
    await visit.page.keyboard.press("Enter");
    await visit.page.locator(".entrance .fault").waitFor();
    await field.fill(token);
    await visit.page.keyboard.press("Enter");
    await visit.overlaid();
    const kept = await visit.page.evaluate(() => JSON.stringify({ ...localStorage, ...sessionStorage }) + document.cookie + location.href);
    assert.ok(!kept.includes(token.slice(9, 30)), "the token is kept");
    const others = visit.complaints.filter((complaint) => !/401|WebSocket/.test(complaint)); // the browser tells refusals itself
    assert.deepEqual(others, []);
    await visit.close();
    await guarded.stop();
    made.remove();
  },

  async "text full of markup is shown as it is"(browser, service) {
    const document = `# ${MARKUP}\nname = "evil"\ndescription = "${MARKUP}"\ncoordinates = ["x", "y"]\nchannels = ["phi"]\n[parameters]\nbx = { start = "centroid.x", unit = "<b>px</b>" }\nby = { start = "centroid.y" }\nv = { start = "amplitude" }\n[roles]\ncentre = ["bx", "by"]\n[model]\nintensity = "v * exp(-((x - bx)^2 + (y - by)^2) / 2000)"\n`;
    const put = await fetch(`${service.url}/v1/models/evil`, { method: "PUT", headers: { "content-type": "application/toml" }, body: document });
    assert.equal(put.status, 201, await put.text());
    await json(`${service.url}/v1/sessions/evil`, { method: "PUT", headers: { "content-type": "application/json" }, body: JSON.stringify({ source: "demo", model: "evil" }) });
    const visit = await Visit.open(browser, service);
    let isAlerted = false;
    visit.page.on("dialog", (dialog) => { isAlerted = true; void dialog.dismiss(); });
    await visit.go("live");
    await visit.page.getByLabel("session").selectOption("evil");
    await visit.page.locator(".formula-card h3", { hasText: MARKUP }).waitFor();
    await visit.page.locator("table.parameters td", { hasText: "<b>px</b>" }).waitFor();
    for (const view of ["model", "explorer", "sources", "plots"]) {
      await visit.page.evaluate((to) => { location.hash = to; }, view);
      await visit.page.locator(`nav a[href="#${view}"][aria-current]`).waitFor();
      if (view === "model") await visit.page.locator(".cm-line", { hasText: MARKUP }).first().waitFor();
    }
    assert.equal(await visit.page.locator("main img, main script, main b:text-is('px')").count(), 0);
    assert.equal(isAlerted, false);
    assert.deepEqual(visit.complaints, []);
    await visit.close();
    await fetch(`${service.url}/v1/sessions/evil`, { method: "DELETE" });
    await fetch(`${service.url}/v1/models/evil`, { method: "DELETE" });
  },

  async "a service that goes away and comes back"(browser) {
    const first = await serve(["--demo"]);
    const visit = await Visit.open(browser, first);
    await visit.go("live");
    await visit.overlaid();
    await first.stop();
    await visit.waitForState("disconnected");
    const second = await serve(["--demo"], new URL(first.url).host);
    await visit.waitForState("tracking");
    await visit.close();
    await second.stop();
  },

  async "a service without sessions says how to begin"(browser) {
    const empty = await serve([]);
    const visit = await Visit.open(browser, empty);
    await visit.go("live");
    await visit.waitForState("first start");
    await visit.page.getByRole("button", { name: "Start the demo" }).click();
    await visit.overlaid();
    assert.deepEqual(visit.complaints, []);
    await visit.close();
    await empty.stop();
  },

  async "a shadow beside the session, promoted"(browser, service) {
    const visit = await Visit.open(browser, service);
    await visit.go("model");
    await visit.page.getByLabel("open a model").selectOption("gaussian");
    await visit.page.locator(".said [data-key='model.intensity']", { hasText: "exp" }).waitFor();
    await visit.page.locator("#shadow").click();
    const panel = visit.page.getByLabel("shadow", { exact: true });
    await panel.locator("tr", { hasText: "χ²/ν" }).filter({ hasText: /\d.*\d/ }).waitFor();
    // The spot's light, seen by a Gaussian: too dark in a ring and in the middle. Noise is neither, once it is averaged.
    const dark = (which: number) => visit.page.evaluate((at) => {
      const canvas = document.querySelectorAll<HTMLCanvasElement>(".pair canvas")[at];
      if (!canvas?.width) return 0;
      const copy = new OffscreenCanvas(24, 24).getContext("2d", { willReadFrequently: true })!;
      copy.imageSmoothingQuality = "high";
      copy.drawImage(canvas, 0, 0, 24, 24);
      const { data } = copy.getImageData(0, 0, 24, 24);
      let blue = 0;
      for (let i = 0; i < data.length; i += 4) if (data[i + 2]! - data[i]! > 50) blue += 1;
      return blue;
    }, which);
    await until(async () => await dark(1) >= 5 && await dark(1) > 3 * await dark(0), "the shadow's residual beside the session's");
    await panel.getByRole("button", { name: "Promote" }).click();
    await visit.page.locator(".swap", { hasText: /gaussian active at frame/ }).waitFor();
    await fetch(`${service.url}/v1/sessions/demo/model`, { method: "PUT", headers: { "content-type": "application/json" }, body: '{"model": "spot"}' });
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },

  async "a link of 4 Mbit/s keeps going, compressed"(browser, service) {
    const slow = await slowed(service, 4_000_000);
    const visit = await Visit.open(browser, slow);
    let pictures = 0;
    visit.page.on("websocket", (socket) => {
      if (/preview\?part=frame/.test(socket.url())) socket.on("framereceived", () => { pictures += 1; });
    });
    await visit.go("live");
    await visit.overlaid();
    await visit.page.locator(".key", { hasText: "JPEG" }).waitFor({ timeout: 30_000 });
    await visit.page.waitForTimeout(9000); // until the rate has settled
    pictures = 0;
    await visit.page.waitForTimeout(5000);
    const told = await visit.page.locator(".stage .key .quiet").textContent();
    assert.ok(pictures > 5, `${pictures} pictures in 5 s`);
    await visit.close();
    await slow.stop();
    return `${(pictures / 5).toFixed(1)} pictures a second; ${told}`;
  },

  async "what each view costs at 30 frames a second"(browser, service) {
    const visit = await Visit.open(browser, service);
    await visit.go("live");
    await visit.overlaid();
    const client = await visit.context.newCDPSession(visit.page);
    /** With what the thread has waited for a processor, and without. */
    const share = async (timeDomain: "timeTicks" | "threadTicks") => {
      await client.send("Performance.enable", { timeDomain });
      const busy = async () => (await client.send("Performance.getMetrics")).metrics.find((metric) => metric.name === "TaskDuration")!.value;
      const [before, start] = [await busy(), performance.now()];
      await visit.page.waitForTimeout(5000);
      const found = 100 * (await busy() - before) / ((performance.now() - start) / 1000);
      await client.send("Performance.disable");
      return found.toFixed(1);
    };
    const costs: string[] = [];
    for (const view of ["live", "plots", "model", "explorer", "sources"]) {
      await visit.go(view);
      await visit.page.waitForTimeout(3000);
      costs.push(`${view} ${await share("timeTicks")} (${await share("threadTicks")})`);
    }
    assert.deepEqual(visit.complaints, []);
    await visit.close();
    return `% of the time that the page's thread is busy (of a core): ${costs.join(", ")}`;
  },

  async "what viewers take of the service's memory"(browser) {
    const watched = await serve(["--demo"]);
    const megabytes = () => Number(/^VmRSS:\s*(\d+) kB$/m.exec(readFileSync(`/proc/${watched.pid}/status`, "utf8"))![1]) / 1024;
    const settled = async () => { await new Promise((done) => setTimeout(done, 4000)); return megabytes(); };
    const visits: Visit[] = [];
    const look = async (count: number) => {
      while (visits.length < count) {
        const visit = await Visit.open(browser, watched);
        visits.push(visit);
        await visit.go("live");
        await visit.overlaid();
      }
      return settled();
    };
    const [nobody, one, five] = [await settled(), await look(1), await look(5)];
    for (const visit of visits) await visit.close();
    await watched.stop();
    const each = (five - nobody) / 5;
    assert.ok(each <= 20, `${each.toFixed(1)} MiB a viewer`);
    return `${nobody.toFixed(0)} MiB, with one viewer ${one.toFixed(0)}, with five ${five.toFixed(0)}`;
  },

  async "estimates as a file"(browser, service) {
    const visit = await Visit.open(browser, service);
    await visit.go("plots");
    await visit.page.locator(".charts canvas").first().waitFor();
    const waiting = visit.page.waitForEvent("download");
    await visit.page.waitForTimeout(500);
    await visit.page.getByRole("button", { name: "CSV" }).click();
    const made = folder();
    const file = join(made.path, "demo.csv");
    await (await waiting).saveAs(file);
    const [head, first] = readFileSync(file, "utf8").split("\n");
    assert.match(head!, /^frame,time_s,state,model,bx,.*sigma_bx/);
    assert.equal(first!.split(",").length, head!.split(",").length);
    writeFileSync(file, "");
    made.remove();
    assert.deepEqual(visit.complaints, []);
    await visit.close();
  },
};
