// A slow link: everything that comes from a service passes through at so many bits a second.
import { createServer, connect } from "node:net";
import type { AddressInfo } from "node:net";
import type { Service } from "./service.ts";

const TICK_MS = 20;

export function slowed(service: Service, bitsPerSecond: number): Promise<Service> {
  const { hostname, port } = new URL(service.url);
  let left = 0; // bytes that may pass in this tick, of all connections together
  const waiting = new Set<() => void>();
  const timer = setInterval(() => {
    left = bitsPerSecond / 8 * TICK_MS / 1000;
    for (const go of [...waiting]) go();
  }, TICK_MS);
  const server = createServer((near) => {
    const far = connect(Number(port), hostname);
    near.pipe(far);
    const queue: Buffer[] = [];
    const go = () => {
      while (left > 0 && queue[0]) {
        const piece = queue[0].subarray(0, Math.ceil(left));
        left -= piece.length;
        near.write(piece);
        if (piece.length === queue[0].length) queue.shift();
        else queue[0] = queue[0].subarray(piece.length);
      }
      if (queue.length === 0) {
        waiting.delete(go);
        far.resume();
      }
    };
    far.on("data", (bytes: Buffer) => {
      queue.push(bytes);
      far.pause(); // what does not fit stays in the service, as on a slow line
      waiting.add(go);
    });
    const end = () => { waiting.delete(go); near.destroy(); far.destroy(); };
    for (const socket of [near, far]) { socket.on("close", end); socket.on("error", end); }
  });
  return new Promise((done) => server.listen(0, "127.0.0.1", () => done({
    url: `http://127.0.0.1:${(server.address() as AddressInfo).port}`,
    async stop() { clearInterval(timer); server.close(); },
  })));
}
