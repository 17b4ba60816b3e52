// A real browser and the servers that it looks at, for all tests of the page.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { after, before } from "node:test";
import { chromium } from "playwright-core";
import { bring, clean, demo, rest as ask, serve } from "./server.mjs";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
// Labels have at most 63 characters, names of models no slash.
export const HOSTILE = `<img src=x onerror="document.title='owned'"><script>`;
export const PATIENCE_MS = 60_000;
const DESK = { width: 1440, height: 900 };
export const PHONE = { width: 390, height: 844 };

let browser;
/** The demo while it runs. */
export let driven;
/** A server on what the demo has left. */
export let server;

before(async () => {
    browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--disable-dev-shm-usage"] });
    driven = await demo();
});

after(async () => {
    await browser?.close();
    await clean();
});

/** Once the demo's robot has arrived. */
export async function serveDriven() {
    await driven.ended;
    server = await serve(driven.data);
}

/** A page that fails the test if it asks anybody else, or if the browser complains. */
export async function open(hash, { url = server.url, viewport = DESK, colorScheme = "light" } = {}) {
    const context = await browser.newContext({ viewport, colorScheme, reducedMotion: "reduce" });
    context.setDefaultTimeout(PATIENCE_MS);
    await bring(context);
    const page = await context.newPage();
    const complaints = [];
    page.on("request", (request) => {
        const asked = request.url();
        if (!asked.startsWith(`${url}/`) && !/^(blob:|data:)/.test(asked)) complaints.push(`it asked for ${asked}`);
    });
    page.on("pageerror", (error) => complaints.push(`${error.stack}`));
    page.on("console", (message) => {
        // That the server refused is what some tests are about.
        if (message.type() === "error" && !message.text().startsWith("Failed to load resource")) complaints.push(message.text());
    });
    await page.goto(`${url}/${hash}`);
    const close = async () => {
        await context.close();
        assert.deepEqual(complaints, []);
    };
    return { page, close };
}

export const rest = (path, { url = server.url, ...init } = {}) => ask(path, { url, ...init });

export { colours } from "./looking.mjs";

/** A frame by which the demo's map closes a loop, in the middle of the drive: which frames do, the model decides. */
export const closingFrame = async (init) => {
    const { loop_closures } = await rest("maps/demo/loop-closures?page_size=100", init);
    return Number(loop_closures[Math.floor(loop_closures.length / 2)].frame.sequence);
};

/** WCAG's rules, as far as a program can tell. The content policy lets no script in but by the debugger. */
export async function accessible(page, what) {
    await page.evaluate(AXE);
    const { violations } = await page.evaluate(() => globalThis.axe.run());
    const found = violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html.slice(0, 160)).join(" | ")}`);
    assert.deepEqual(found, [], what);
}

export const cursor = (page) => page.getByTestId("cursor");
