// A map that is larger than the page draws at once: the server thins it, and gives more where one looks closely.
import assert from "node:assert/strict";
import { test } from "node:test";
import { accessible, cursor, open, PATIENCE_MS, PHONE, rest } from "./browser.mjs";
import { colours, panned } from "./looking.mjs";
import { grown, until } from "./server.mjs";

/** More than are drawn at once; LARGE_PLACES for figures, as of PERFORMANCE.md. */
const PLACES = Number(process.env.LARGE_PLACES ?? 10_400);

let server;
/** One server for both tests: nobody else may open its data meanwhile. */
const served = async () => (server ??= await grown(PLACES));

test("a large map is thinned, is drawn closer where one zooms in, and is stepped through in windows", async (context) => {
    const large = await served();
    const { page, close } = await open("#/maps/load", { url: large.url });
    const began = Date.now();
    await page.reload();
    const canvas = page.locator(".drawing canvas");
    await until("the drawing", async () => (await colours(canvas)) > 8);
    const painted_ms = Date.now() - began;
    const { places } = await rest("maps/load", { url: large.url });
    const every = Math.ceil(places / 10_000);
    assert.ok(every > 1, `${places} places are not too many`);
    await page.getByTestId("thinned").filter({ hasText: `one of ${every} places along the way` }).waitFor();
    const drawn = async () => Number(await canvas.getAttribute("data-drawn"));
    assert.equal(await drawn(), Math.ceil(places / every));
    assert.equal(await page.getByTestId("kind").textContent(), "in metres");
    const fps = await panned(page, canvas);
    await page.getByRole("button", { name: "Show the whole map" }).click();

    const list = await open("#/operations", { url: large.url });
    const asked_places = [];
    list.page.on("request", (request) => request.url().includes("/maps/load/places") && asked_places.push(request.url()));
    await list.page.goto(`${large.url}/#/maps`);
    await until("the thumbnail", async () => (await colours(list.page.locator(".thumbnail canvas"))) > 8);
    assert.ok(asked_places.length <= 3 && asked_places.every((url) => url.includes(`every=${Math.ceil(places / 2500)}`)), asked_places.join(" "));
    await list.close();

    const time = page.getByRole("region", { name: "Time" });
    const { first_sequence, last_sequence, frames } = await rest("maps/load/sessions/growing", { url: large.url });
    await time.getByLabel("Session").selectOption({ label: "growing" });
    await time.getByText(`frames ${first_sequence} to ${(2000).toLocaleString("en-GB")}, of ${frames.toLocaleString("en-GB")}`).waitFor();
    await page.keyboard.press("End");
    await cursor(page).filter({ hasText: `frame ${last_sequence}:` }).waitFor();
    assert.ok(await page.getByRole("button", { name: "Next frame" }).isDisabled());
    await page.getByRole("button", { name: "Frame before" }).click();
    await cursor(page).filter({ hasText: `frame ${last_sequence - 1}:` }).waitFor();
    await page.keyboard.press("Home");
    await cursor(page).filter({ hasText: `frame ${first_sequence}:` }).waitFor();
    // Across the border of two windows.
    await page.goto(`${large.url}/#/maps/load?session=growing&frame=1499`);
    await cursor(page).filter({ hasText: "frame 1499:" }).waitFor();
    for (const frame of [1500, 1501, 1502]) {
        await page.keyboard.press("ArrowRight");
        await cursor(page).filter({ hasText: `frame ${frame}:` }).waitFor();
    }

    // A place that is not among those that are drawn.
    await page.getByLabel("Go to place").fill(String(every + 1));
    await page.getByRole("button", { name: "Go", exact: true }).click();
    await page.getByRole("heading", { name: `Place ${every + 1}`, exact: true }).waitFor();
    const { pose } = await rest(`maps/load/places/${every + 1}`, { url: large.url });
    const { x, y } = pose.pose.position_m;
    const before = await drawn();
    await page.goto(`${large.url}/#/maps/load?view=${x},${y},30`);
    await until("more places", async () => (await drawn()) > before);
    const box = await canvas.boundingBox();
    await until("the place under the hand", async () => {
        await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
        return page.url().includes(`place=${every + 1}`);
    });

    await page.goto(`${large.url}/#/maps/load?matrix=.`);
    const matrix = page.getByRole("region", { name: "Match matrix" }).locator("canvas");
    const asked = Date.now();
    await matrix.waitFor();
    await matrix.scrollIntoViewIfNeeded();
    const tiles = () => until("all tiles", async () => (await matrix.getAttribute("data-complete")) === "true", 600);
    await tiles();
    const matrix_ms = Date.now() - asked;
    const matrix_fps = await panned(page, matrix);
    await tiles();
    await accessible(page, "a large map");
    context.diagnostic(JSON.stringify({ places, painted_ms, fps, matrix_ms, matrix_fps }));
    await close();

    const phone = await open("#/maps/load", { url: large.url, viewport: PHONE, colorScheme: "dark" });
    await until("the drawing", async () => (await colours(phone.page.locator(".drawing canvas"))) > 8);
    const wide = await phone.page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok(wide <= 0, `a large map is ${wide} px wider than a phone`);
    await phone.close();
}, { timeout: 30 * PATIENCE_MS });

test("of a large map that has lost places nothing stays of those, though they were drawn closer", async () => {
    const large = await served();
    const { page, close } = await open("#/maps", { url: large.url });
    // Nothing is taken from what was grown: the page is told of fewer places, as by a server that has removed a session.
    const left = 9000;
    let removed = false;
    const number = ({ name }) => Number(name.split("/").at(-1));
    await page.route(/\/v1\/maps\/load(\?|$)/, async (route) => {
        const answer = await route.fetch();
        const map = await answer.json();
        return route.fulfill({ response: answer, json: removed ? { ...map, places: left } : map });
    });
    await page.route(/\/v1\/maps\/load\/places\?/, async (route) => {
        const answer = await route.fetch();
        const listed = await answer.json();
        return route.fulfill({ response: answer, json: removed ? { ...listed, places: listed.places.filter((place) => number(place) < left) } : listed });
    });
    const event = (name, id, data) => `event: ${name}\nid: ${id}\ndata: ${JSON.stringify(data)}\n\n`;
    const other = event("error", "", { status: 409, error: { code: "aborted", message: "sessions were removed" } }).replace("id: \n", "");
    await page.route("**/v1/maps/load/events", (route) => {
        const goesOn = "last-event-id" in route.request().headers();
        const log = removed ? "other" : "first";
        return route.fulfill({ contentType: "text/event-stream", body: removed && goesOn ? other : event("started", `${log}-0`, {}) });
    });
    const { pose } = await rest(`maps/load/places/${left + 700}`, { url: large.url });
    const { x, y } = pose.pose.position_m;
    await page.goto(`${large.url}/#/maps/load?view=${x},${y},30`);
    const canvas = page.locator(".drawing canvas");
    const drawn = async () => Number(await canvas.getAttribute("data-drawn"));
    const { places } = await rest("maps/load", { url: large.url });
    const thinned = Math.ceil(places / Math.ceil(places / 10_000));
    await until("more places", async () => (await drawn()) > thinned);
    removed = true;
    await until("what is left", async () => (await drawn()) === left);
    await close();
}, { timeout: 10 * PATIENCE_MS });
