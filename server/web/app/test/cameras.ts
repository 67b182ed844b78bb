// Cameras: one that is not there, whose driver's answers are made up, and one of the kernel's own drivers in a virtual machine.
import assert from "node:assert/strict";
import type { Check } from "./checks.ts";
import { until } from "./checks.ts";
import { hasRig, json, serveInRig, Visit } from "./service.ts";

const DEVICE = "usb-046d_C920_7A3F";
/** Above this the driver clamps without a word. */
const GAIN_MAX = 180;

function camera() {
  const range = { minimum: 0, maximum: 255, step: 5, default: 0 };
  return {
    device: "/dev/video0", identity: DEVICE, name: "A webcam", driver: "uvcvideo", bus: "usb-1",
    formats: [
      { format: "GREY", is_read: true, sizes: [{ width: 640, height: 480, rates_hz: [60, 30] }] },
      { format: "S920", is_read: false, sizes: [{ width: 320, height: 240, rates_hz: [15] }] },
    ],
    controls: [
      { name: "auto_exposure", kind: "menu", minimum: 0, maximum: 3, step: 1, default: 3, value: 3, items: { 1: "manual", 3: "aperture priority" } },
      { name: "exposure_time_absolute", kind: "integer", minimum: 3, maximum: 2047, step: 1, default: 250, value: 250, is_inactive: true },
      { name: "gain", kind: "integer", ...range, value: 20 },
      { name: "backlight", kind: "boolean", ...range, value: 0 },
    ],
  };
}

export const cameras: Record<string, Check> = {
  async "a camera's controls"(browser, service) {
    const visit = await Visit.open(browser, service);
    const { page } = visit;
    const there = camera();
    const control = (name: string) => there.controls.find((one) => one.name === name)!;
    const [puts, started]: [Record<string, number>[], { options: { exposure: { control: boolean } } }[]] = [[], []];
    let isHeld = false;
    await page.route("**/v1/sources", (route) => route.fulfill({ json: { items: [{ name: "demo", kind: "camera", device: DEVICE, state: "running", frames: 9, sessions: 1 }] } }));
    await page.route("**/v1/cameras", (route) => route.fulfill({ json: { items: [there] } }));
    await page.route(`**/v1/cameras/${DEVICE}`, (route) => route.fulfill({ json: there }));
    await page.route(`**/v1/cameras/${DEVICE}/controls`, async (route) => {
      if (isHeld) {
        const problem = { type: "urn:isophote:problem:in-use", detail: "arm-3 has the knobs of `demo` for another 4 s" };
        return route.fulfill({ status: 409, contentType: "application/problem+json", json: problem });
      }
      const asked = route.request().postDataJSON() as Record<string, number>;
      puts.push(asked);
      for (const [name, value] of Object.entries(asked)) control(name).value = Math.min(Number(value), name === "gain" ? GAIN_MAX : Infinity);
      control("exposure_time_absolute").is_inactive = control("auto_exposure").value === 3;
      return route.fulfill({ json: { controls: asked } });
    });
    await page.route("**/v1/sessions/demo", async (route) => {
      if (route.request().method() !== "PUT") return route.fallback();
      started.push(route.request().postDataJSON());
      return route.fulfill({ json: {} });
    });
    await visit.go("sources");
    const panel = page.getByLabel("camera", { exact: true }).and(page.locator("section"));
    const gain = panel.getByLabel("gain", { exact: true });
    await gain.waitFor();
    assert.deepEqual(await gain.evaluate((one: HTMLInputElement) => [one.min, one.max, one.step, one.value]), ["0", "255", "5", "20"], "the driver's range");
    await gain.focus();
    await page.keyboard.press("ArrowRight");
    await until(async () => puts.at(-1)?.["gain"] === 25, "the gain is set");
    await page.keyboard.press("End");
    await until(async () => (await gain.inputValue()) === String(GAIN_MAX), "what the driver made of it is shown");
    const exposure = panel.locator(".slider", { hasText: "exposure time absolute" }).locator("output");
    assert.match((await exposure.textContent())!, /automatic/);
    await panel.getByLabel("auto exposure").selectOption("manual");
    await until(async () => /250 × 100 µs/.test((await exposure.textContent())!), "by hand again");
    await panel.getByLabel("backlight").check();
    await until(async () => control("backlight").value === 1, "the switch is on");
    assert.match((await panel.locator("table").textContent())!, /GREY640 × 48060.*30/);
    assert.equal(await panel.locator("table", { hasText: "S920" }).count(), 0, "what is not read is not offered");
    assert.match((await panel.textContent())!, /Exposure advice: × \d/);
    await panel.getByLabel("Auto exposure").click();
    await until(async () => started.at(-1)?.options.exposure.control === true, "the closed loop begins");
    isHeld = true;
    await panel.getByLabel("backlight").click();
    await panel.locator(".fault", { hasText: "arm-3 has the knobs" }).waitFor();
    await until(async () => panel.getByLabel("backlight").isChecked(), "it is as it was");
    assert.deepEqual(visit.complaints.filter((one) => !/409/.test(one)), []);
    await visit.close();
  },

  async "the controls of a driver"(browser) {
    if (!hasRig) return "skipped: no rig with cameras beside the repository, or not root";
    const rig = await serveInRig([], 17300 + (process.pid % 400)).catch((error: Error) => {
      if (/ended with 12[45]/.test(error.message)) return null; // the rig itself, or a machine that is too slow for it
      throw error;
    });
    if (!rig) return "skipped: the rig cannot be started here";
    const { items: [there] } = await json<{ items: Camera[] }>(`${rig.url}/v1/cameras`);
    const named = async (name: string) => (await json<Camera>(`${rig.url}/v1/cameras/${there!.identity}`)).controls.find((one) => one.name === name)!;
    const source = { kind: "camera", device: there!.device, format: "GREY", width: 320, height: 180, rate_hz: 5 };
    const put = (path: string, document: object) =>
      json(`${rig.url}${path}`, { method: "PUT", headers: { "content-type": "application/json" }, body: JSON.stringify(document) });
    await put("/v1/sources/lab", source);
    await put("/v1/sessions/lab", { source: "lab", model: "gaussian" });
    const visit = await Visit.open(browser, rig);
    await visit.go("sources");
    const panel = visit.page.getByLabel("camera", { exact: true }).and(visit.page.locator("section"));
    const slider = panel.getByLabel("brightness", { exact: true });
    await slider.waitFor({ timeout: 60_000 });
    const before = await named("brightness");
    const range = await slider.evaluate((one: HTMLInputElement) => [one.min, one.max, one.step, one.value].map(Number));
    assert.deepEqual(range, [before.minimum, before.maximum, before.step, before.value], "the driver's range and value");
    await slider.focus();
    await visit.page.keyboard.press("ArrowRight");
    await until(async () => (await named("brightness")).value === before.value + before.step, "the driver has taken the slider's value");
    const flip = panel.getByLabel("horizontal flip", { exact: true });
    const was = await flip.isChecked();
    await flip.click();
    await until(async () => Boolean((await named("horizontal_flip")).value) === !was, "the driver has taken the switch");
    assert.deepEqual(visit.complaints, []);
    await visit.close();
    await rig.stop();
    return `${there!.driver}, ${there!.controls.length} controls`;
  },
};

interface Control { name: string; minimum: number; maximum: number; step: number; value: number }
interface Camera { device: string; identity: string; driver: string; controls: Control[] }
