// Figures of PERFORMANCE.md: how soon a map is drawn, how smoothly it is dragged, and what a tile of its match matrix costs.
// Not a test: no figure fails it.
//     npm run figures -- 1000 10000
// makes maps of so many places by the programs of WAYPOST_BINARIES. FIGURES_DATA is a folder with maps that
// `waypost-eval load growth --keep-data FOLDER/PLACES` has left; they are made there where they are missing.
import { mkdirSync } from "node:fs";
import { loadavg, tmpdir } from "node:os";
import { join } from "node:path";
import { chromium } from "playwright-core";
import { colours, panned } from "./looking.mjs";
import { bring, clean, grown, rest, until } from "./server.mjs";

// It prints JSON without being asked to.
const SIZES = process.argv.slice(2).filter((word) => word !== "--json").map(Number);
const TIMES = 5;
/** Tiles of the match matrix by the pairs along their side, for maps that have so many places. */
const TILES = [{ level: 0, pairs: 256 }, { level: 5, pairs: 8192 }];
const kept = process.env.FIGURES_DATA;

const median = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];

/** From the beginning of the page's load to its first drawing, by the browser's own clock: milliseconds. */
const drawnAt = (page) => page.evaluate(() => new Promise((drawn) => {
    const look = () => {
        const canvas = document.querySelector(".drawing canvas");
        if (Number(canvas?.dataset.drawn) > 0) return drawn(performance.now());
        requestAnimationFrame(look);
    };
    look();
}));

/** What the server's processor did so far, in seconds. */
async function processor_s(url) {
    const metrics = await (await fetch(`${url}/metrics`)).text();
    return Number(/^waypost_process_cpu_seconds (\S+)$/m.exec(metrics)[1]);
}

/** What an answer takes the server's processor, in seconds, and how large it is. */
async function cost(url, path) {
    const before = await processor_s(url);
    const answer = await fetch(`${url}/v1/maps/load/${path}`);
    if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
    const { byteLength: bytes } = await answer.arrayBuffer();
    return { processor_s: Number((await processor_s(url) - before).toFixed(2)), bytes };
}

async function measure(browser, places) {
    if (kept) mkdirSync(kept, { recursive: true });
    const { url } = await grown(places, join(kept ?? join(tmpdir(), `waypost-figures-${process.pid}`), String(places)));
    const context = await browser.newContext({ viewport: { width: 1440, height: 900 } });
    context.setDefaultTimeout(600_000);
    await bring(context);
    const page = await context.newPage();
    const there = (await rest("maps/load", { url })).places;
    const drawn_ms = [];
    for (let time = 0; time <= TIMES; time++) {
        await page.goto("about:blank");
        await page.goto(`${url}/#/maps/load`, { waitUntil: "commit" });
        drawn_ms.push(await drawnAt(page));
    }
    // The first look has the server read the map from its disk.
    const [first_ms, ...others_ms] = drawn_ms;
    const canvas = page.locator(".drawing canvas");
    await until("the drawing", async () => (await colours(canvas)) > 8);
    await page.getByRole("heading", { name: "Gates" }).waitFor({ timeout: 20_000 }).catch(() => {});
    const fps = [];
    for (let time = 0; time < TIMES; time++) fps.push(await panned(page, canvas));
    const drawn = Number(await canvas.getAttribute("data-drawn"));
    await context.close();
    const tiles = {};
    const matrix = await cost(url, "matrix");
    for (const { level, pairs } of TILES.filter(({ pairs }) => pairs <= there)) {
        tiles[`of_${pairs}`] = await cost(url, `matrix/tiles/${level}/0/0`);
    }
    return {
        matrix, tiles,
        places: there, drawn, first_ms: Math.round(first_ms), drawn_ms: Math.round(median(others_ms)),
        worst_ms: Math.round(Math.max(...others_ms)), fps: Number(median(fps).toFixed(1)), least_fps: Number(Math.min(...fps).toFixed(1)),
        load: Number(loadavg()[0].toFixed(1)),
    };
}

if (!SIZES.length || !SIZES.every((places) => Number.isInteger(places) && places > 0)) {
    console.error("say for how many places: npm run figures -- 1000 10000");
    process.exit(2);
}
const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--disable-dev-shm-usage"] });
try {
    const figures = [];
    for (const places of SIZES) figures.push(await measure(browser, places));
    console.log(JSON.stringify(figures));
} finally {
    await browser.close();
    await clean();
}
