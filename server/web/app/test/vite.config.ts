// The test as one script for Node, beside the packages that it needs.
import { defineConfig } from "vite";

export default defineConfig({
  build: { ssr: "test/page.ts", outDir: "node_modules/.page-test", emptyOutDir: true, target: "node20" },
});
