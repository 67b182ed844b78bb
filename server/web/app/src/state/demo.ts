// What `serve --demo` starts, for a service that was started without it.
import { said, send } from "./api";
import { look, refresh } from "./store";

const SOURCE = {
  kind: "synthetic", model: "spot", width: 640, height: 480, rate_hz: 30,
  motion: { bx: "320 + 110*sin(2*pi*0.20*t)", by: "240 + 70*cos(2*pi*0.13*t)" },
  samples: 2, full_well_e: 5000, read_noise_e: 15, seed: 1,
};

/** What went wrong, or nothing. */
export async function beginDemo(): Promise<string> {
  try {
    await send("PUT", "/v1/sources/demo", SOURCE);
    await send("PUT", "/v1/sessions/demo", { source: "demo", model: "spot", camera: { electrons_per_dn: 19.6, read_noise_e: 15 } });
    await refresh();
    look("demo");
    return "";
  } catch (error) {
    return said(error);
  }
}
