// Opens the page in a browser and uses it as people do. `npm test`; `npm test -- NAME` runs what has NAME in its name. Ends with 77
// where there is no browser. `UPDATE_EXPECT=1` writes the book's pictures anew.
import { cameras } from "./cameras.ts";
import { checks } from "./checks.ts";
import { more } from "./more.ts";
import { pictures } from "./pictures.ts";
import { browserPath, launch, serve } from "./service.ts";
import { state } from "./state.ts";

if (!browserPath()) process.exit(77);
const wanted = process.argv[2] ?? "";
const browser = await launch();
const service = await serve(["--demo"]);
let failed = 0;
for (const [name, check] of Object.entries({ ...checks, ...more, ...state, ...cameras, ...pictures })) {
  if (!name.includes(wanted)) continue;
  const start = performance.now();
  try {
    const late = new Promise<never>((_, failed) => setTimeout(() => failed(new Error("not done within two minutes")), 120_000).unref());
    const told = await Promise.race([check(browser, service), late]);
    console.log(`ok    ${name}${told ? `: ${told}` : ""} (${((performance.now() - start) / 1000).toFixed(1)} s)`);
  } catch (error) {
    failed += 1;
    console.log(`FAILED ${name}: ${error instanceof Error ? error.stack : error}`);
  }
}
await browser.close();
await service.stop();
process.exit(failed === 0 ? 0 : 1);
