// What panels look like, against pictures that are kept: shrunk, and with some room, for fonts and browsers differ a
// little. INSPECTOR_PICTURES=renew keeps what is seen now; look at it before it is committed.
import assert from "node:assert/strict";
import { existsSync, mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { closingFrame, colours, cursor, open, rest } from "./browser.mjs";
import { REPOSITORY, until } from "./server.mjs";

const PICTURES = join(REPOSITORY, "inspector/tests/pictures");
const RENEW = process.env.INSPECTOR_PICTURES === "renew";
/** Pixels of the screen that become one: what is written in small is a shade. */
const SHRINK = 4;
/** A pixel of a shrunk picture is another from this difference of a channel on, of 255. */
const ANOTHER = 32;
/** The share of other pixels, of those that are not of the background, from which on it is another picture. */
const MOST_OTHERS = 0.07;

/** In a browser's page: a picture made small, and the share of what is drawn that is not as in the one that is kept. */
async function compare({ shot, kept, shrink, another }) {
    const read = async (url, by) => {
        const image = new Image();
        image.src = url;
        await image.decode();
        const canvas = document.createElement("canvas");
        [canvas.width, canvas.height] = [Math.round(image.width / by), Math.round(image.height / by)];
        const context = canvas.getContext("2d");
        context.imageSmoothingQuality = "high";
        context.drawImage(image, 0, 0, canvas.width, canvas.height);
        return { canvas, pixels: context.getImageData(0, 0, canvas.width, canvas.height).data };
    };
    const now = await read(shot, shrink);
    const small = now.canvas.toDataURL("image/png");
    if (!kept) return { small, size: null, others: 1 };
    const before = await read(kept, 1);
    const size = [now, before].map(({ canvas }) => `${canvas.width} × ${canvas.height}`);
    const apart = (one, other) => [0, 1, 2].some((channel) => Math.abs(one[channel] - other[channel]) >= another);
    const colour = ({ pixels }, at) => pixels.slice(at, at + 3);
    // Most of a panel is empty, so that what is missing is little of the whole.
    const counts = new Map();
    for (let at = 0; at < before.pixels.length; at += 4) counts.set(`${colour(before, at)}`, (counts.get(`${colour(before, at)}`) ?? 0) + 1);
    const background = [...counts].sort(([, a], [, b]) => b - a)[0][0].split(",").map(Number);
    let [drawn, others] = [0, 0];
    for (let at = 0; at < now.pixels.length; at += 4) {
        const [one, other] = [colour(now, at), colour(before, at)];
        if (apart(one, background) || apart(other, background)) drawn++;
        if (apart(one, other)) others++;
    }
    return { small, size, others: others / drawn };
}

const url = (bytes) => `data:image/png;base64,${bytes.toString("base64")}`;

async function looksAsBefore(page, panel, name) {
    // Photographs and texts would be most of what is drawn, and hide that a line is missing: other tests read them, and
    // fonts differ. How much room they take is still seen.
    const maskColor = await panel.evaluate((panel) => getComputedStyle(panel).backgroundColor);
    const shot = url(await panel.screenshot({ animations: "disabled", scale: "css", mask: [panel.locator("header, .legend, .strip")], maskColor }));
    const file = join(PICTURES, `${name}.png`);
    const seen = join(PICTURES, `${name}.seen.png`);
    const kept = existsSync(file) && !RENEW ? url(readFileSync(file)) : null;
    const blank = await page.context().newPage();
    const { small, size, others } = await blank.evaluate(compare, { shot, kept, shrink: SHRINK, another: ANOTHER });
    await blank.close();
    mkdirSync(PICTURES, { recursive: true });
    const bytes = Buffer.from(small.split(",")[1], "base64");
    if (RENEW) return writeFileSync(file, bytes);
    writeFileSync(seen, bytes);
    const mend = `compare ${seen} with ${file}; if it is right, INSPECTOR_PICTURES=renew keeps it`;
    assert.ok(size, `there is no picture of ${name}: ${mend}`);
    assert.equal(size[0], size[1], `${name} has another size: ${mend}`);
    assert.ok(others <= MOST_OTHERS, `${(100 * others).toFixed(1)} % of ${name} look different: ${mend}`);
    rmSync(seen);
}

for (const colorScheme of ["light", "dark"]) {
    test(`the map and its time look as they did, ${colorScheme}`, async () => {
        const closing = await closingFrame();
        const { page, close } = await open(`#/maps/demo?frame=${closing}`, { colorScheme });
        await cursor(page).filter({ hasText: `frame ${closing}: loop closure` }).waitFor();
        const { places } = await rest("maps/demo");
        const canvas = page.locator(".canvas canvas");
        await until("the drawing", async () => (await canvas.getAttribute("data-drawn")) === String(places));
        await page.getByRole("heading", { name: "Gates" }).waitFor();
        const strip = page.getByRole("group", { name: "Frames around the cursor" }).locator("button");
        await until("all thumbnails", () => strip.evaluateAll((frames) => frames.length > 3 && frames.every((frame) => frame.querySelector("img")?.naturalWidth > 0)));
        await until("the posterior", async () => (await colours(page.locator(".heat canvas"))) > 8);
        await page.getByRole("button", { name: "Delete the session" }).waitFor();
        await page.mouse.move(0, 0);
        await looksAsBefore(page, page.getByRole("region", { name: "The map" }), `map-${colorScheme}`);
        await looksAsBefore(page, page.getByRole("region", { name: "Time" }), `time-${colorScheme}`);
        await close();
    });
}
