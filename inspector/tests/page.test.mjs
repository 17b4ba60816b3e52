// The page in a real browser, on what the demo made, against what REST says.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { chromium } from "playwright-core";
import { clean, demo, folder, serve, until } from "./server.mjs";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
// Labels have at most 63 characters, names of models no slash.
const HOSTILE = `<img src=x onerror="document.title='owned'"><script>`;
const PATIENCE_MS = 60_000;
const DESK = { width: 1440, height: 900 };
const PHONE = { width: 390, height: 844 };

let browser;
let server;
let driven;

before(async () => {
    browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--disable-dev-shm-usage"] });
    driven = await demo();
});

after(async () => {
    await browser?.close();
    await clean();
});

/** A page that fails the test if it asks anybody else, or if the browser complains. */
async function open(hash, { url = server.url, viewport = DESK, colorScheme = "light" } = {}) {
    const context = await browser.newContext({ viewport, colorScheme, reducedMotion: "reduce" });
    context.setDefaultTimeout(PATIENCE_MS);
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

const rest = async (path, { url = server.url, token, ...init } = {}) => {
    const headers = { ...init.headers, ...(token && { authorization: `Bearer ${token}` }) };
    const answer = await fetch(`${url}/v1/${path}`, { ...init, headers });
    assert.ok(answer.ok, `${path}: ${answer.status}`);
    return answer.json();
};

/** A frame by which the demo's map closes a loop, in the middle of the drive: which frames do, the model decides. */
const closingFrame = async (init) => {
    const { loop_closures } = await rest("maps/demo/loop-closures?page_size=100", init);
    return Number(loop_closures[Math.floor(loop_closures.length / 2)].frame.sequence);
};

/** WCAG's rules, as far as a program can tell. The content policy lets no script in but by the debugger. */
async function accessible(page, what) {
    await page.evaluate(AXE);
    const { violations } = await page.evaluate(() => globalThis.axe.run());
    const found = violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html.slice(0, 160)).join(" | ")}`);
    assert.deepEqual(found, [], what);
}

const cursor = (page) => page.getByTestId("cursor");

/** Whether more than the background was drawn. */
const colours = (canvas) => canvas.evaluate((canvas) => {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return new Set(new Uint32Array(data.buffer)).size;
});

test("a robot that is led is shown while it drives", async () => {
    await until("the taught map", async () => (await fetch(`${driven.url}/v1/maps/taught`)).ok);
    const { page, close } = await open("#/maps/taught", { url: driven.url });
    const robots = page.getByRole("region", { name: "Robots" });
    await robots.getByRole("heading", { name: /^robot / }).waitFor({ timeout: 2 * PATIENCE_MS });
    const there = await robots.textContent();
    assert.match(there, /is at/);
    assert.match(there, /goes to/);
    await robots.getByRole("button", { name: "Cancel its goal: stop" }).waitFor();
    await close();
    await driven.ended;
    server = await serve(driven.data);
});

test("the list shows what REST says of each map, and draws it", async () => {
    const { page, close } = await open("");
    const { maps } = await rest("maps");
    assert.deepEqual(maps.map(({ name }) => name), ["maps/demo", "maps/taught"]);
    for (const map of maps) {
        const card = page.getByRole("listitem").filter({ has: page.getByRole("heading", { name: map.name.slice(5), exact: true }) });
        const words = await card.textContent();
        for (const shown of [`${map.places} places`, `${map.frames} frames`, `${map.loop_closures} loop closure`, `${map.links} links`, "1 session"]) {
            assert.ok(words.includes(shown), `${words} has no ${shown}`);
        }
        await card.getByText(/ MB/).waitFor();
        const canvas = card.locator("canvas");
        await canvas.waitFor();
        await until("the thumbnail", async () => (await colours(canvas)) > 8);
    }
    await accessible(page, "the list");
    await page.getByRole("link", { name: "demo", exact: true }).click();
    await page.getByRole("heading", { level: 1, name: "demo" }).waitFor();
    assert.match(page.url(), /#\/maps\/demo/);
    await page.goBack();
    await page.getByRole("heading", { level: 1, name: "Maps" }).waitFor();
    await close();
});

test("a map without metres is a ring whose frames are stepped by keyboard", async () => {
    const closing = await closingFrame();
    const { page, close } = await open(`#/maps/demo?session=session-0&frame=${closing}`);
    assert.match(await page.getByTestId("kind").textContent(), /without metres/);
    await cursor(page).filter({ hasText: `frame ${closing}: loop closure` }).waitFor();
    const canvas = page.locator(".canvas canvas");
    const { places } = await rest("maps/demo");
    await until("the drawing", async () => (await canvas.getAttribute("data-drawn")) === String(places));
    assert.ok((await colours(canvas)) > 8);

    const { frames } = await rest("maps/demo/sessions/session-0/frames?page_size=200");
    const reason = (sequence) => frames[sequence - 1].answer.reason.replaceAll("_", " ");
    await page.keyboard.press("ArrowRight");
    await cursor(page).filter({ hasText: `frame ${closing + 1}: ${reason(closing + 1)}` }).waitFor();
    assert.ok(page.url().includes(`frame=${closing + 1}`), page.url());
    await page.keyboard.press("ArrowLeft");
    await page.keyboard.press("ArrowLeft");
    await cursor(page).filter({ hasText: `frame ${closing - 1}: ${reason(closing - 1)}` }).waitFor();
    await page.keyboard.press("End");
    await cursor(page).filter({ hasText: `frame 152: ${reason(152)}` }).waitFor();
    assert.ok(await page.getByRole("button", { name: "Next frame" }).isDisabled());
    await page.keyboard.press("Home");
    await cursor(page).filter({ hasText: "frame 1: new place" }).waitFor();
    // Faster than the page is drawn.
    await page.evaluate(() => [1, 2, 3].forEach(() => dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", cancelable: true }))));
    await cursor(page).filter({ hasText: "frame 4:" }).waitFor();
    await page.keyboard.press("Home");
    await cursor(page).filter({ hasText: "frame 1: new place" }).waitFor();

    const strip = page.getByRole("group", { name: "Frames around the cursor" });
    await strip.getByRole("button", { name: "Frame 4:" }).click();
    await cursor(page).filter({ hasText: "frame 4:" }).waitFor();
    await until("thumbnails", () => strip.locator("img").first().evaluate((image) => image.complete && image.naturalWidth > 0));
    const likely = frames[3].answer;
    const described = await page.locator(".plot").getAttribute("aria-label");
    assert.ok(described.includes(`new ${likely.new_place_posterior.toFixed(3)}`), described);
    assert.ok(described.includes(`place ${likely.posterior.toFixed(3)}`), described);
    assert.ok(described.includes("threshold 0.99"), described);
    assert.ok((await colours(page.locator(".heat canvas"))) > 8);
    await close();
});

test("a pair shows the gates and numbers of REST, and both images", async () => {
    const closing = await closingFrame();
    const { page, close } = await open(`#/maps/demo?frame=${closing}`);
    const pair = page.getByRole("region", { name: "The pair" });
    const explained = await rest(`maps/demo/sessions/session-0/frames/${closing}/explanation`);
    await pair.getByRole("heading", { name: "Gates" }).waitFor();
    const { note, answer } = await rest(`maps/demo/sessions/session-0/frames/${closing}`);
    assert.match(note, /^\d{6}\.jpg$/);
    assert.equal(await pair.getByTestId("note").textContent(), note);
    const gates = await pair.locator(".gates li").allTextContents();
    assert.equal(gates.length, explained.gates.length);
    explained.gates.forEach(({ description, passed }, at) => {
        assert.ok(gates[at].includes(description), gates[at]);
        assert.ok(gates[at].includes(passed ? "✓ passed" : "✕ not passed"), gates[at]);
    });
    const { inliers, matches, probability } = answer.match.geometry;
    const facts = await pair.textContent();
    // What is all but certain is not rounded to certainty.
    const shown = probability > 0.9995 ? "> 0.999" : probability.toFixed(3);
    assert.ok(facts.includes(`${inliers} of ${matches}`) && facts.includes(shown), facts);
    const picture = pair.locator("img");
    await until("the picture", () => picture.evaluate((image) => image.naturalWidth > 300));
    await pair.getByRole("button", { name: /^Enlarge/ }).click();
    await page.getByRole("dialog").locator("img").waitFor();
    assert.match(page.url(), /large=1/);
    await page.keyboard.press("Escape");
    await until("the pair alone", async () => !page.url().includes("large"));

    const closures = page.getByRole("region", { name: "Loop closures" });
    const { loop_closures } = await rest("maps/demo/loop-closures?page_size=100");
    assert.equal(await closures.locator("tbody tr").count(), loop_closures.length);
    const least = loop_closures.reduce((a, b) => (b.probability < a.probability ? b : a));
    await closures.locator("tbody tr").first().getByRole("button").first().click();
    await cursor(page).filter({ hasText: `frame ${least.frame.sequence}: loop closure` }).waitFor();
    await accessible(page, "a map without metres");
    await close();
});

test("a metric map has metres, and a place is picked by hand and by number", async () => {
    const { page, close } = await open("#/maps/taught", { colorScheme: "dark" });
    assert.equal(await page.getByTestId("kind").textContent(), "in metres");
    const canvas = page.locator(".canvas canvas");
    await until("the drawing", async () => (await canvas.getAttribute("data-drawn")) === "84");
    await page.getByLabel("Go to place").fill("7");
    await page.getByRole("button", { name: "Go", exact: true }).click();
    const place = page.getByRole("region", { name: "The place" });
    await place.getByRole("heading", { name: "Place 7" }).waitFor();
    const known = await rest("maps/taught/places/7");
    const { x, y } = known.pose.pose.position_m;
    await place.getByText(`${x.toFixed(2)}, ${y.toFixed(2)} m`).waitFor();
    assert.deepEqual(await place.locator(".links button").allTextContents(), known.linked_place_numbers.map((number) => `place ${number}`));
    await cursor(page).filter({ hasText: `frame ${known.frames[0].sequence}:` }).waitFor();

    // The place lies in the middle of this link's picture, so that is where the hand picks it.
    await page.goto(`${server.url}/#/maps/taught?view=${x},${y},200`);
    const box = await canvas.boundingBox();
    await until("the place under the hand", async () => {
        await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
        return /place=7/.test(page.url());
    });
    await page.getByRole("button", { name: "Zoom out" }).click();
    await until("the link of what is seen", async () => /view=/.test(page.url()) && !page.url().endsWith(",200"));
    await page.getByRole("button", { name: "Show the whole map" }).click();
    await until("the whole map", async () => !page.url().includes("view="));
    await page.getByLabel("From odometry alone to corrected").press("Home");
    await until("the wheels alone", async () => /corrected=0/.test(page.url()));
    await page.getByText("by wheels alone").waitFor();
    await page.getByText("Links by what is left over").click();
    await page.getByRole("group", { name: "Table of links" }).locator("tbody tr").first().waitFor();
    await accessible(page, "a metric map, dark");
    await close();
});

test("a label is written, found, shown as text whatever it says, and removed", async () => {
    const { page, close } = await open("#/maps/demo?place=5");
    const place = page.getByRole("region", { name: "The place" });
    await place.getByLabel("Label").fill(HOSTILE);
    await place.getByRole("button", { name: "Save" }).click();
    const labels = async () => (await rest("maps/demo/labels")).labels;
    await Promise.race([place.getByText("saved").waitFor(), place.locator(".refused").waitFor()]);
    assert.deepEqual(await labels(), [{ place: "maps/demo/places/5", label: HOSTILE }]);
    await page.reload();
    await until("the label", async () => (await place.getByLabel("Label").inputValue()) === HOSTILE);
    await page.getByLabel("Go to place").fill(HOSTILE);
    await page.getByRole("button", { name: "Go", exact: true }).click();
    await place.getByRole("heading", { name: "Place 5" }).waitFor();
    await place.getByRole("button", { name: "Remove" }).click();
    await place.getByText("removed").waitFor();
    assert.deepEqual(await labels(), []);
    await page.goto(`${server.url}/#/maps/${encodeURIComponent(HOSTILE)}?frame=1`);
    await page.getByRole("alert").waitFor();
    assert.equal(await page.locator("#page img[src='x'], #page script").count(), 0);
    assert.ok(!(await page.title()).startsWith("owned"));
    await close();
});

test("a server with nothing says how to begin; names of models are text", async () => {
    const empty = await serve(join(folder, "empty"));
    await empty.call(null, "model", "rm", "shipped");
    const { page, close } = await open("", { url: empty.url });
    await page.getByText("There is no map yet.").waitFor();
    await accessible(page, "no maps");
    await empty.call(null, "model", "import", "--name", HOSTILE, "demo/model.waypost");
    await page.getByRole("link", { name: "Operations" }).click();
    const { models } = await rest("models", { url: empty.url });
    assert.equal(models[0].display_name, HOSTILE);
    await page.getByRole("cell", { name: HOSTILE, exact: true }).waitFor();
    await page.getByText("No job has run").waitFor();
    await empty.call(null, "map", "create", "bare", "--model", models[0].name.slice(7));
    await page.goto(`${empty.url}/#/maps/bare`);
    await page.getByText("This map has no places yet").waitFor();
    await accessible(page, "a map without places");
    await close();
});

test("jobs and models are those of REST", async () => {
    const file = join(folder, "demo.waypost-map");
    await server.call(null, "map", "export", "demo", file);
    await server.call(null, "map", "import", file, "--name", "copy");
    const { page, close } = await open("#/operations");
    const { jobs } = await rest("jobs");
    const row = page.getByRole("region", { name: "Jobs" }).locator("tbody tr").first();
    const words = await row.textContent();
    assert.ok(words.includes("import map") && words.includes(jobs[0].state), words);
    await accessible(page, "operations");
    await close();
});

test("on a phone nothing is wider than the screen", async () => {
    for (const hash of ["#/maps", "#/maps/taught?frame=20", "#/maps/demo?frame=109", "#/operations"]) {
        const { page, close } = await open(hash, { viewport: PHONE });
        await page.locator("main h1, main .panel").first().waitFor();
        if (hash.includes("frame")) await page.getByRole("heading", { name: "Gates" }).waitFor();
        const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
        assert.ok(wide <= 0, `${hash} is ${wide} px wider than the screen`);
        if (hash.includes("taught")) await accessible(page, "a map on a phone");
        await close();
    }
});

test("a map is made, exported, imported under another name, and deleted by who types its name", async () => {
    const { page, close } = await open("");
    await page.getByRole("button", { name: "New map" }).click();
    const making = page.getByRole("dialog", { name: "New map" });
    await making.getByLabel("Name").fill("No Name");
    await making.getByLabel("Keep of each frame").selectOption("images");
    await making.getByRole("button", { name: "Make the map" }).click();
    await making.getByText("is no map name").waitFor();
    await accessible(page, "a new map");
    await making.getByLabel("Name").fill("office");
    await making.getByRole("button", { name: "Make the map" }).click();
    await page.getByRole("heading", { name: "office", exact: true }).waitFor();
    assert.equal((await rest("maps/office")).settings.keep, "images");

    const coming = page.waitForEvent("download");
    await page.getByRole("button", { name: "Export the map taught" }).click();
    const file = join(folder, "Taught Again.waypost-map");
    await (await coming).saveAs(file);
    await page.getByRole("button", { name: "Import a map" }).click();
    const importing = page.getByRole("dialog", { name: "Import a map" });
    await importing.getByLabel("Snapshot").setInputFiles(file);
    assert.equal(await importing.getByLabel("Name").inputValue(), "taught-again");
    await importing.getByLabel("Name").fill("taught");
    await importing.getByRole("button", { name: "Import it" }).click();
    await importing.getByText("choose another name").waitFor();
    await importing.getByLabel("Name").fill("taught-again");
    await importing.getByRole("button", { name: "Import it" }).click();
    await page.getByRole("heading", { name: "taught-again", exact: true }).waitFor();
    const [there, again] = await Promise.all(["taught", "taught-again"].map((map) => rest(`maps/${map}?view=full`)));
    assert.equal(again.state_hash, there.state_hash);

    await page.getByRole("button", { name: "Delete the map taught-again" }).click();
    const leaving = page.getByRole("dialog", { name: "Delete the map taught-again?" });
    assert.match(await leaving.textContent(), new RegExp(`${there.places} places`));
    await accessible(page, "a map to be deleted");
    const remove = leaving.getByRole("button", { name: "Delete the map" });
    assert.ok(await remove.isDisabled());
    await leaving.getByRole("textbox").fill("taught");
    assert.ok(await remove.isDisabled());
    await page.keyboard.press("Escape");
    await leaving.waitFor({ state: "detached" });
    for (const map of ["taught-again", "office"]) {
        await page.getByRole("button", { name: `Delete the map ${map}`, exact: true }).click();
        await page.getByRole("dialog").getByRole("textbox").fill(map);
        await page.getByRole("dialog").getByRole("button", { name: "Delete the map" }).click();
        await page.getByRole("heading", { name: map, exact: true }).waitFor({ state: "detached" });
    }
    const { maps } = await rest("maps");
    assert.deepEqual(maps.filter(({ name }) => /office|again/.test(name)), []);
    await close();
});

test("a model goes out and in by its file, and one that a map uses stays", async () => {
    const { page, close } = await open("#/operations");
    const panel = page.getByRole("region", { name: "Models" });
    const [{ name, display_name }] = (await rest("models")).models;
    const called = display_name || name.slice(7, 19);
    const coming = page.waitForEvent("download");
    await panel.getByRole("button", { name: `Export the model ${called}` }).click();
    const file = join(folder, "out.waypost");
    await (await coming).saveAs(file);
    await panel.getByRole("button", { name: `Delete the model ${called}` }).click();
    await page.getByRole("dialog").getByRole("textbox").fill(called);
    await page.getByRole("dialog").getByRole("button", { name: "Delete the model" }).click();
    await page.getByRole("dialog").getByText("delete the map first").waitFor();
    await page.getByRole("button", { name: "Close" }).click();

    const bare = await serve(join(folder, "bare"));
    await bare.call(null, "model", "rm", "shipped");
    const other = await open("#/operations", { url: bare.url });
    const models = other.page.getByRole("region", { name: "Models" });
    await models.getByText("There is no model yet").waitFor();
    await models.getByLabel("Model file").setInputFiles(join(folder, "demo.waypost-map"));
    await models.getByRole("button", { name: "Import a model" }).click();
    await models.getByRole("alert").waitFor();
    await models.getByLabel("Model file").setInputFiles(file);
    await models.getByLabel("Name").fill("site");
    await models.getByRole("button", { name: "Import a model" }).click();
    await models.getByRole("cell", { name: "site", exact: true }).waitFor();
    assert.equal((await rest("models", { url: bare.url })).models[0].name, name);
    await models.getByRole("button", { name: "Delete the model site" }).click();
    await other.page.getByRole("dialog").getByRole("textbox").fill("site");
    await other.page.getByRole("dialog").getByRole("button", { name: "Delete the model" }).click();
    await models.getByText("There is no model yet").waitFor();
    await other.close();
    await close();
});

test("a job that runs can be cancelled, and how the server fares is drawn", async () => {
    const { page, close } = await open("#/operations");
    // A job that goes on for as long as it is looked at: how long real ones take is the machine's affair.
    const job = { name: "jobs/77", kind: "train_model", state: "running", stage: "learning words", fraction: 0.25, error: null, result: null, create_time_ns: 1e18, end_time_ns: null };
    await page.route("**/v1/jobs?*", (route) => route.fulfill({ json: { jobs: [job], next_page_token: "" } }));
    const asked = [];
    await page.route("**/v1/jobs/77/cancel", (route) => {
        asked.push(route.request().method());
        Object.assign(job, { state: "cancelled" });
        return route.fulfill({ json: job });
    });
    const jobs = page.getByRole("region", { name: "Jobs" });
    await jobs.getByRole("button", { name: "Cancel job 77" }).click();
    await jobs.getByRole("cell", { name: "cancelled", exact: true }).waitFor();
    assert.deepEqual(asked, ["POST"]);
    await jobs.getByRole("button", { name: "Cancel job 77" }).waitFor({ state: "detached" });

    const metrics = page.getByRole("region", { name: "Metrics" });
    await metrics.getByRole("img", { name: /^Requests: REST (0\.\d*[1-9]|[1-9])/ }).waitFor();
    await metrics.getByRole("img", { name: /^Database: size [1-9]/ }).waitFor();
    const requests = metrics.getByRole("img", { name: /^Requests/ }).locator("canvas");
    await until("its line", async () => (await colours(requests)) > 3);
    await accessible(page, "metrics");
    await close();
});

test("the first token is an admin's, is shown once, and is the page's own from then on", async () => {
    const fresh = await serve(join(folder, "fresh"));
    await fresh.call(null, "model", "rm", "shipped");
    const { page, close } = await open("#/operations", { url: fresh.url });
    const tokens = page.getByRole("region", { name: "Tokens" });
    await tokens.getByText("There is none").waitFor();
    await tokens.getByLabel("Name of a new token").fill("operator");
    await tokens.getByRole("button", { name: "Make a token" }).click();
    const shown = tokens.locator(".secret");
    await shown.getByText("The secret of operator.").waitFor();
    const admin = await shown.locator("code").textContent();
    assert.match(admin, /^waypost_[0-9a-f]{64}$/);
    await page.context().grantPermissions(["clipboard-read", "clipboard-write"]);
    await shown.getByRole("button", { name: "Copy" }).click();
    await shown.getByText("copied", { exact: true }).waitFor();
    assert.equal(await page.evaluate(() => navigator.clipboard.readText()), admin);
    await page.getByRole("button", { name: "Log out" }).waitFor();
    await tokens.getByText("(this page’s)").waitFor();
    await accessible(page, "a secret");
    await tokens.getByLabel("Name of a new token").fill("reader");
    await tokens.getByRole("button", { name: "Make a token" }).click();
    await shown.getByText("The secret of reader.").waitFor();
    const robot = await shown.locator("code").textContent();
    assert.ok(!(await tokens.textContent()).includes(admin), "a secret is shown again");
    const who = await rest("whoami", { url: fresh.url, token: robot });
    assert.deepEqual(who, { token: "tokens/reader", role: "robot", asks_for_token: true });

    // A robot's token: nothing is offered that it may not do.
    const other = await open("#/operations", { url: fresh.url });
    await other.page.getByLabel("Token").fill(robot);
    await other.page.getByRole("button", { name: "Log in" }).click();
    await other.page.getByText("There is no model yet").waitFor();
    await other.page.locator(".who", { hasText: "reader" }).waitFor();
    assert.equal(await other.page.getByRole("region", { name: "Tokens" }).count(), 0);
    assert.equal(await other.page.getByRole("button", { name: /Import|Delete|Cancel/ }).count(), 0);
    await other.page.getByRole("link", { name: "Maps" }).click();
    await other.page.getByText("There is no map yet.").waitFor();
    assert.equal(await other.page.getByRole("button", { name: /New map|Import/ }).count(), 0);

    await tokens.getByRole("button", { name: "Delete the token reader" }).click();
    await page.getByRole("dialog").getByRole("textbox").fill("reader");
    await page.getByRole("dialog").getByRole("button", { name: "Delete the token" }).click();
    await tokens.getByRole("rowheader", { name: "reader" }).waitFor({ state: "detached" });
    await other.page.getByRole("heading", { name: "This server asks for a token" }).waitFor();
    await other.close();
    await close();
});

// Last, for from here on this server asks for tokens.
test("a server with tokens asks for one, and shows what its holder may see", async () => {
    const secretOf = (text) => text.match(/waypost_\w+/)[0];
    const admin = secretOf(await server.call(null, "token", "create", "operator", "--role", "admin"));
    const robot = secretOf(await server.call(admin, "token", "create", "reader", "--role", "robot"));
    const closing = await closingFrame({ token: admin });
    const { page, close } = await open(`#/maps/demo?frame=${closing}`);
    await page.getByRole("heading", { name: "This server asks for a token" }).waitFor();
    await accessible(page, "the way in");
    const body = await page.locator("body").textContent();
    assert.ok(!body.includes("152 frames"), "something was shown without a token");
    await page.getByLabel("Token").fill("waypost_0");
    await page.getByRole("button", { name: "Log in" }).click();
    await page.getByText("not known here").waitFor();
    await page.getByLabel("Token").fill(robot);
    await page.getByRole("button", { name: "Log in" }).click();
    await cursor(page).filter({ hasText: `frame ${closing}: loop closure` }).waitFor();
    await until("a picture by token", () => page.locator(".pair img").evaluate((image) => image.naturalWidth > 300));
    assert.ok(!page.url().includes(robot), "the secret is in the link");
    await page.reload();
    await cursor(page).filter({ hasText: `frame ${closing}` }).waitFor();
    await server.call(admin, "token", "rm", "reader");
    await page.getByRole("heading", { name: "This server asks for a token" }).waitFor();
    await page.getByLabel("Token").fill(admin);
    await page.getByRole("button", { name: "Log in" }).click();
    await cursor(page).filter({ hasText: `frame ${closing}` }).waitFor();
    await page.getByRole("link", { name: "Maps" }).click();
    const coming = page.waitForEvent("download");
    await page.getByRole("button", { name: "Export the map demo" }).click();
    assert.equal((await coming).suggestedFilename(), "demo.waypost-map");
    await page.getByRole("button", { name: "Log out" }).click();
    await page.getByRole("heading", { name: "This server asks for a token" }).waitFor();
    assert.equal(await page.evaluate(() => sessionStorage.length), 0);
    await close();
});
