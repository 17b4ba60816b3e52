// Numbers of frames that no double holds.
import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { cursor, open, rest, server } from "./browser.mjs";
import { REPOSITORY, until } from "./server.mjs";

const IMAGES = join(REPOSITORY, "demo/sequence/images");
const images = readdirSync(IMAGES).filter((name) => name.endsWith(".jpg")).sort();

let seconds = 0;

/** Sends images of the demo's sequence as frames, the first of which has this number. */
async function send(map, session, first, some) {
    for (const [at, image] of some.entries()) {
        const path = `maps/${map}/sessions/${session}/frames/${BigInt(first) + BigInt(at)}?stamp_ns=${1e9 * ++seconds}`;
        await rest(path, { method: "PUT", headers: { "content-type": "image/jpeg" }, body: readFileSync(join(IMAGES, image)) });
    }
}

async function made(map) {
    const { model } = await rest("maps/demo");
    await server.call(null, "map", "create", map, "--model", model.slice(7));
}

/** What a picture shows, once it is there. */
const shows = (picture) => until("a picture", () => picture.evaluate((image) => {
    if (!image.complete || image.naturalWidth === 0) return null;
    const canvas = Object.assign(document.createElement("canvas"), { width: 16, height: 12 });
    canvas.getContext("2d").drawImage(image, 0, 0, 16, 12);
    return canvas.toDataURL();
}));

test("frames whose numbers no double holds are found, stepped through and linked to", async () => {
    const first = 2n ** 63n - 9n;
    const [second, last] = [first + 1n, first + 7n];
    await made("stamped");
    await send("stamped", "robot", first, images.slice(0, 8));
    const { page, close } = await open(`#/maps/stamped?session=robot&frame=${second}`);
    await cursor(page).filter({ hasText: `frame ${second}:` }).waitFor();
    const pair = page.getByRole("region", { name: "The pair" });
    await pair.getByText("Gates").or(pair.getByText("somewhere new, by words")).first().waitFor();
    assert.equal(await page.getByRole("alert").count(), 0);
    await page.keyboard.press("ArrowRight");
    await cursor(page).filter({ hasText: `frame ${second + 1n}:` }).waitFor();
    assert.ok(page.url().includes(`frame=${second + 1n}`), page.url());
    await page.keyboard.press("End");
    await cursor(page).filter({ hasText: `frame ${last}:` }).waitFor();
    await page.reload();
    await cursor(page).filter({ hasText: `frame ${last}:` }).waitFor();
    const strip = page.getByRole("group", { name: "Frames around the cursor" });
    await shows(strip.getByRole("button", { name: `Frame ${last}:` }).locator("img"));
    await shows(pair.locator("img"));

    // By a place, to the frame that it learnt from.
    await page.getByLabel("Go to place").fill("0");
    await page.getByRole("button", { name: "Go", exact: true }).click();
    const place = page.getByRole("region", { name: "The place" });
    const look = place.getByRole("button", { name: `Frame ${first} of robot` });
    await look.waitFor();
    await shows(look.locator("img"));
    await cursor(page).filter({ hasText: `frame ${first}:` }).waitFor();
    assert.equal(await page.getByRole("alert").count(), 0);

    // As they come: the cursor follows a robot.
    await page.getByLabel("follow").check();
    await page.getByTestId("live").filter({ hasText: "live" }).waitFor();
    await send("stamped", "robot", last + 1n, images.slice(8, 9));
    await cursor(page).filter({ hasText: `frame ${last + 1n}:` }).waitFor();
    await close();
    await server.call(null, "map", "rm", "stamped", "--yes");
});
