// The page: three files with stable names, and under page/ the parts that are loaded when they are first needed. `npm run dev`
// serves the sources, and hands everything else to the service on port 7240.
import { defineConfig } from "vite";

const service = "http://127.0.0.1:7240";

export default defineConfig({
  base: "./",
  build: {
    outDir: "../dist",
    emptyOutDir: true,
    target: "es2022",
    modulePreload: { polyfill: false },
    assetsInlineLimit: 0,
    cssCodeSplit: false,
    rollupOptions: {
      output: {
        entryFileNames: "page.js",
        chunkFileNames: "page/[name].js",
        assetFileNames: "page.[ext]",
      },
    },
  },
  worker: { format: "es", rollupOptions: { output: { entryFileNames: "page/picture.js" } } },
  server: { proxy: Object.fromEntries(["/v1", "/docs", "/livez", "/metrics"].map((path) => [path, { target: service, ws: true }])) },
});
