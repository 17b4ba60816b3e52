// A map while a robot streams into it, and sessions that leave it.
import assert from "node:assert/strict";
import { copyFileSync, mkdirSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { accessible, cursor, open, rest, server } from "./browser.mjs";
import { folder, REPOSITORY, until } from "./server.mjs";

const IMAGES = join(REPOSITORY, "demo/sequence/images");

/** The first images of the demo's sequence, for a robot to stream; one that goes on sends those that are new. */
function drive(count) {
    const some = join(folder, `drive-${count}`);
    mkdirSync(some, { recursive: true });
    for (const image of readdirSync(IMAGES).sort().slice(0, count)) copyFileSync(join(IMAGES, image), join(some, image));
    return some;
}

const stream = (count, ...more) => server.call(null, "stream", drive(count), "--map", "live", "--session", "first", ...more);

const live = (page, words) => page.getByTestId("live").filter({ hasText: words }).waitFor();

/** What the server says first from the beginning on: some whole events. */
async function beginning(events) {
    const answer = await fetch(`${server.url}/v1/maps/live/events?from_position=0`);
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let whole = [];
    for (let text = ""; whole.length <= events; whole = text.split("\n\n")) text += (await reader.read()).value;
    await reader.cancel();
    return `${whole.slice(0, events).join("\n\n")}\n\n`;
}

test("a map grows on the page while a robot streams, and the cursor goes with it", async () => {
    const { model } = await rest("maps/demo");
    await server.call(null, "map", "create", "live", "--model", model.slice(7));
    const { page, close } = await open("#/operations");
    const asked = [];
    const ended = [];
    page.on("request", (request) => asked.push(request.url()));
    page.on("requestfailed", (request) => ended.push(request.url()));
    const listed = await open("#/maps");
    const card = listed.page.getByRole("listitem").filter({ has: listed.page.getByRole("heading", { name: "live", exact: true }) });
    const present = (words) => card.getByTestId("present").filter({ hasText: words }).waitFor();
    await present("no robot there now");
    const began = Date.now();
    await page.goto(`${server.url}/#/maps/live`);
    await live(page, "live");
    await page.getByText("This map has no places yet").waitFor();
    await page.getByLabel("follow").check();
    await until("the link of who follows", async () => page.url().includes("follow=1"));
    const streamed = stream(12, "--rate", "2");
    const robots = page.getByRole("region", { name: "Robots" });
    await robots.getByRole("heading", { name: /^first/ }).waitFor();
    await robots.getByRole("button", { name: /^frame \d+/ }).waitFor();
    await robots.getByText(/^\d+ of \d+ frames heard \(\d+ %\)$/).waitFor();
    await robots.getByText(/^\d s ago$/).waitFor();
    await robots.getByText(/^\d+ answered$/).waitFor();
    await robots.getByText(/^\d+ ms$/).waitFor();
    await robots.getByText("last probability").waitFor();
    await present("1 robot streaming now");
    await accessible(listed.page, "a robot in the list");
    await streamed;
    await present("no robot there now");
    await listed.close();
    await cursor(page).filter({ hasText: "frame 12:" }).waitFor();
    const { places } = await rest("maps/live");
    const canvas = page.locator(".canvas canvas");
    await until("all places", async () => (await canvas.getAttribute("data-drawn")) === String(places));
    await page.getByText("12 frames", { exact: false }).first().waitFor();
    await accessible(page, "a map that grows");
    // By events alone: robots are only asked for to learn which have gone.
    assert.equal(asked.filter((url) => url.endsWith("/events")).length, 1);
    const most = 2 + Math.ceil((Date.now() - began) / 15_000);
    assert.ok(asked.filter((url) => url.includes("/navigations")).length <= most, "it asks all the time");

    await page.keyboard.press("Home");
    await cursor(page).filter({ hasText: "frame 1:" }).waitFor();
    assert.ok(!page.url().includes("follow"), "who looks back does not follow");
    await page.getByRole("link", { name: "Maps" }).click();
    await until("the end of the events", async () => ended.some((url) => url.endsWith("/events")));
    await close();
});

test("a robot that maps new ground is drawn where it is, in metres", async () => {
    const { model } = await rest("maps/taught");
    await server.call(null, "map", "create", "ground", "--model", model.slice(7));
    const { page, close } = await open("#/maps/ground");
    await live(page, "live");
    const driving = server.call(null, "simulate", "--map", "ground", "--world", "office", "--session", "first");
    const canvas = page.locator(".drawing canvas");
    const [size, seen] = [{}, new Map()];
    await until("a robot that moves", async () => {
        const [robot] = JSON.parse(await canvas.getAttribute("data-robots"));
        Object.assign(size, await canvas.boundingBox());
        if (robot) seen.set(`${robot.x} ${robot.y}`, robot);
        return seen.size > 3;
    });
    for (const { name, doing, x, y, heading } of seen.values()) {
        assert.deepEqual([name, doing, typeof heading], ["first", "streams", "number"]);
        assert.ok(x >= 0 && y >= 0 && x <= size.width && y <= size.height, `${x}, ${y} is not seen`);
    }
    await driving;
    await close();
    await server.call(null, "map", "rm", "ground", "--yes");
});

test("a robot that only looks is drawn and told where it is, though the map keeps none of its frames", async () => {
    const { page, close } = await open("#/maps/demo");
    await live(page, "live");
    const before = await rest("maps/demo?view=full");
    const looking = server.call(null, "stream", drive(12), "--map", "demo", "--localize", "--session", "looker", "--rate", "2");
    const canvas = page.locator(".drawing canvas");
    await until("a robot that looks", async () => {
        const [robot] = JSON.parse(await canvas.getAttribute("data-robots"));
        return robot?.name === "looker" && robot.doing === "looks";
    });
    const robots = page.getByRole("region", { name: "Robots" });
    const robot = robots.getByRole("article").filter({ hasText: "looker" });
    await robot.getByRole("button", { name: /^place \d+$/ }).waitFor();
    await robot.getByText("last probability").waitFor();
    await accessible(page, "a robot that only looks");
    await looking;
    await robot.waitFor({ state: "detached" });
    await until("a drawing without it", async () => JSON.parse(await canvas.getAttribute("data-robots")).length === 0);
    assert.equal((await rest("maps/demo?view=full")).state_hash, before.state_hash);
    await close();
});

test("events that are cut off go on behind the last one that came", async () => {
    const { page, close } = await open("#/maps");
    const cut = await beginning(3);
    const last = cut.match(/^id: ?\S+$/gm).at(-1).replace(/^id: ?/, "");
    const positions = [];
    await page.route("**/v1/maps/live/events", (route) => {
        positions.push(route.request().headers()["last-event-id"] ?? null);
        if (positions.length > 1) return route.continue();
        return route.fulfill({ contentType: "text/event-stream", body: cut });
    });
    await page.goto(`${server.url}/#/maps/live?frame=12&session=first&follow=1`);
    await until("another connection", async () => positions.length > 1);
    assert.deepEqual(positions, [null, last]);
    await live(page, "live");
    await stream(16);
    await cursor(page).filter({ hasText: "frame 16:" }).waitFor();
    await page.getByText("16 frames · ", { exact: false }).waitFor();
    await close();
});

test("without events robots are asked for as before, and the page says so", async () => {
    const { page, close } = await open("#/maps");
    await page.route("**/v1/maps/live/events", (route) => route.fulfill({ status: 503, json: {} }));
    const asked = [];
    page.on("request", (request) => request.url().includes("/navigations") && asked.push(request.url()));
    await page.goto(`${server.url}/#/maps/live`);
    await live(page, "asked for again and again");
    await until("robots that are asked for", async () => asked.length > 3);
    await close();
});

test("a session is deleted by who types its name, and the server's refusal is shown", async () => {
    const { page, close } = await open("#/maps/live?session=first");
    const before = await rest("maps/live/sessions/first");
    const time = page.getByRole("region", { name: "Time" });
    await time.getByRole("button", { name: "Delete the session" }).click();
    const leaving = page.getByRole("dialog", { name: "Delete the session first?" });
    assert.match(await leaving.textContent(), new RegExp(`${before.frames} frames`));
    await accessible(page, "a session to be deleted");
    const remove = leaving.getByRole("button", { name: "Delete the session" });
    await leaving.getByRole("textbox").fill("firs");
    assert.ok(await remove.isDisabled());

    // Whoever was slower hears that it is gone.
    const late = await open("#/maps");
    await late.page.route("**/v1/maps/live/events", (route) => route.abort());
    await late.page.goto(`${server.url}/#/maps/live?session=first`);
    await late.page.getByRole("button", { name: "Delete the session" }).click();
    await late.page.getByRole("dialog").getByRole("textbox").fill("first");

    await leaving.getByRole("textbox").fill("first");
    await remove.click();
    await page.getByText("This map has no places yet").waitFor();
    assert.deepEqual((await rest("maps/live/sessions")).sessions, []);
    assert.ok(!page.url().includes("session="), page.url());
    await late.page.getByRole("dialog").getByRole("button", { name: "Delete the session" }).click();
    await late.page.getByRole("dialog").getByText("has no session first").waitFor();
    await late.close();
    await close();
    await server.call(null, "map", "rm", "live", "--yes");
});
