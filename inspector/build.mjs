// Writes the page into server/inspector, from where the server embeds it. The same sources and lock file give the
// same bytes, on any machine: no hash of a path, no time, no source map goes in.
import { copyFile, mkdir, readFile, rm, writeFile } from "node:fs/promises";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const here = fileURLToPath(new URL(".", import.meta.url));
const target = process.argv[2] ?? fileURLToPath(new URL("../server/inspector", import.meta.url));
const MOST_GZIPPED_BYTES = 200_000;

await rm(target, { recursive: true, force: true });
await mkdir(target, { recursive: true });
await build({
    absWorkingDir: here,
    entryPoints: { inspector: "src/main.tsx" },
    outdir: target,
    bundle: true,
    minify: true,
    format: "esm",
    target: "es2022",
    jsx: "automatic",
    jsxImportSource: "preact",
    charset: "ascii",
    legalComments: "none",
    logLevel: "warning",
});
for (const file of ["index.html", "icon.svg"]) await copyFile(`${here}src/${file}`, `${target}/${file}`);

// What the bundle contains of others, with their terms.
const { dependencies } = JSON.parse(await readFile(`${here}package.json`, "utf8"));
const licences = Object.entries(dependencies).map(async ([name, version]) =>
    `${name} ${version}\n\n${await readFile(`${here}node_modules/${name}/LICENSE`, "utf8")}`);
await writeFile(`${target}/licences.txt`, (await Promise.all(licences)).join("\n\n"));

let bytes = 0;
for (const file of ["index.html", "icon.svg", "inspector.js", "inspector.css"]) {
    bytes += gzipSync(await readFile(`${target}/${file}`)).length;
}
console.log(`the inspector takes ${bytes} bytes, gzipped`);
if (bytes > MOST_GZIPPED_BYTES) throw new Error(`more than ${MOST_GZIPPED_BYTES}: leave something out`);
