// Pictures of every view, wide and narrow, light and dark: written to be looked at. Those of the book are written where
// UPDATE_EXPECT is set.
import assert from "node:assert/strict";
import { mkdirSync } from "node:fs";
import { join } from "node:path";
import type { Check } from "./checks.ts";
import { DOCS, OUT, Visit } from "./service.ts";

const VIEWS = ["live", "plots", "model", "explorer", "sources"];
const READY: Record<string, string> = {
  plots: ".charts canvas", model: ".said .formulas math", explorer: "[data-pane=asm] .body > div:nth-child(50)", sources: ".scene .slider",
};

export const pictures: Record<string, Check> = {
  async "pictures of every view"(browser, service) {
    mkdirSync(OUT, { recursive: true });
    for (const [width, height] of [[1440, 900], [390, 844]] as const) {
      for (const scheme of ["light", "dark"] as const) {
        const visit = await Visit.open(browser, service, { width, height, scheme });
        await visit.go("live");
        await visit.overlaid();
        for (const view of VIEWS) {
          await visit.page.evaluate((to) => { location.hash = to; }, view);
          if (READY[view]) await visit.page.locator(READY[view]).first().waitFor({ timeout: 60_000 });
          await visit.page.waitForTimeout(view === "plots" ? 4000 : 1500);
          const across = await visit.page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
          assert.ok(across <= 0, `${view} at ${width} px is ${across} px too wide`);
          await visit.page.screenshot({ path: join(OUT, `${view}-${width}-${scheme}.png`), fullPage: width < 500 });
        }
        assert.deepEqual(visit.complaints, []);
        await visit.close();
      }
    }
    return `in ${OUT}`;
  },

  async "pictures of the book"(browser, service) {
    if (!process.env["UPDATE_EXPECT"]) return "not asked for";
    mkdirSync(DOCS, { recursive: true });
    const visit = await Visit.open(browser, service, { width: 1280, height: 800 });
    await visit.go("live");
    await visit.overlaid();
    for (const view of ["live", "model", "explorer", "sources"]) {
      await visit.page.evaluate((to) => { location.hash = to; }, view);
      if (READY[view]) await visit.page.locator(READY[view]).first().waitFor({ timeout: 60_000 });
      await visit.page.waitForTimeout(1500);
      if (view === "explorer") {
        await visit.page.locator("[data-pane=formulas] [data-key='definitions.s'] msup").first().hover();
        await visit.page.waitForTimeout(300);
      }
      await visit.page.screenshot({ path: join(DOCS, `${view}.png`) });
    }
    await visit.close();
  },
};
