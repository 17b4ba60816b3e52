// Places that get other numbers while they are looked at, and numbers of frames that no double holds.
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

test("places that get other numbers are shown as they are by then, with their labels and pictures", async () => {
    await made("renewed");
    await send("renewed", "early", 1, images.slice(0, 8));
    await send("renewed", "late", 1, images.slice(40, 48));
    const label = (place, label) => rest(`maps/renewed/places/${place}/label`, {
        method: "PUT", headers: { "content-type": "application/json" }, body: JSON.stringify({ label, scope: "place" }),
    });
    await label(0, "the beginning");
    const { page, close } = await open("#/maps/renewed?session=late&frame=1&place=0");
    await page.getByTestId("live").filter({ hasText: "live" }).waitFor();
    const place = page.getByRole("region", { name: "The place" });
    await place.getByRole("button", { name: "Frame 1 of early" }).waitFor();
    const written = place.getByLabel("Label");
    await until("the label", async () => (await written.inputValue()) === "the beginning");
    const pair = page.getByRole("region", { name: "The pair" });
    const decided = async () => (await rest("maps/renewed/sessions/late/frames/1")).answer.place_number;
    const before = await decided();
    await pair.getByRole("definition").filter({ hasText: `place ${before}` }).first().waitFor();

    await server.call(null, "session", "rm", "renewed", "early", "--yes");
    await place.getByRole("button", { name: "Frame 1 of late" }).waitFor();
    assert.equal(await place.getByRole("button", { name: /of early/ }).count(), 0);
    await until("no label", async () => (await written.inputValue()) === "");
    await written.fill("where it goes on");
    await place.getByRole("button", { name: "Save" }).click();
    await place.getByText("saved").waitFor();
    assert.deepEqual((await rest("maps/renewed/labels")).labels, [{ place: "maps/renewed/places/0", label: "where it goes on" }]);
    const after = await decided();
    assert.notEqual(after, before);
    await pair.getByRole("definition").filter({ hasText: `place ${after}` }).first().waitFor();

    // A session that was deleted and driven anew has other pictures of the same names.
    const picture = page.getByRole("group", { name: "Frames around the cursor" }).getByRole("button", { name: "Frame 1:" }).locator("img");
    const early = await shows(picture);
    await server.call(null, "session", "rm", "renewed", "late", "--yes");
    await send("renewed", "late", 1, images.slice(90, 98));
    await until("another picture", async () => (await shows(picture)) !== early);
    await close();
    await server.call(null, "map", "rm", "renewed", "--yes");
});

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
