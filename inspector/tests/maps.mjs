// Maps, drawn and stepped through: what the demo made, against what REST says.
import assert from "node:assert/strict";
import { test } from "node:test";
import { accessible, closingFrame, colours, cursor, driven, HOSTILE, open, PATIENCE_MS, PHONE, rest, server, serveDriven } from "./browser.mjs";
import { until } from "./server.mjs";

test("a robot that is led is shown while it drives", async () => {
    await until("the taught map", async () => (await fetch(`${driven.url}/v1/maps/taught`)).ok);
    // It drives for less than a minute: both pages are there before.
    const list = await open("#/maps", { url: driven.url });
    const { page, close } = await open("#/maps/taught", { url: driven.url });
    const phone = await open("#/maps/taught", { url: driven.url, viewport: PHONE });
    const robots = page.getByRole("region", { name: "Robots" });
    await robots.getByRole("heading", { name: /^robot / }).waitFor({ timeout: 2 * PATIENCE_MS });
    const there = await robots.textContent();
    assert.match(there, /is at/);
    assert.match(there, /goes to/);
    await robots.getByRole("button", { name: "Cancel its goal: stop" }).waitFor();
    await robots.getByText(/\d+ of \d+ frames \(\d+ %\)/).waitFor();
    // The drive that taught it may be shown for a moment yet.
    const led = robots.getByRole("article").filter({ hasText: "goes to" });
    await led.getByText(/^[0-5] s ago$/).waitFor();
    await led.getByText(/^\d+\.\d s and \d+\.\d m before its last word$/).waitFor();
    const drawing = page.getByRole("region", { name: "The map" });
    await drawing.getByText("route of a robot").waitFor();

    // In the drawing it has its name, and looks somewhere.
    const drawnRobots = async (page) => JSON.parse((await page.locator(".drawing canvas").getAttribute("data-robots")) ?? "[]");
    const { navigations: [{ name }] } = await rest("maps/taught/navigations", { url: driven.url });
    const short = name.split("/").at(-1);
    const [seen] = await until("the robot in the drawing", async () => {
        const all = await drawnRobots(page);
        return all.length === 1 && all;
    });
    assert.deepEqual([seen.name, seen.doing, typeof seen.heading], [short, "led", "number"]);
    // On a phone it is right below the drawing, and what stops it is in sight wherever one has scrolled.
    const stop = phone.page.getByRole("button", { name: `Stop ${short}` });
    await stop.waitFor();
    assert.ok((await phone.page.getByRole("region", { name: "Robots" }).boundingBox()).y < PHONE.height);
    const inSight = async () => {
        const { y, height } = await stop.boundingBox();
        return y >= 0 && y + height <= PHONE.height;
    };
    assert.ok(await inSight(), "Stop is out of sight");
    await phone.page.evaluate(() => scrollTo(0, document.body.scrollHeight));
    await until("the end of the page", () => phone.page.evaluate(() => scrollY > innerHeight));
    assert.ok(await inSight(), "Stop is out of sight at the end of the page");
    assert.equal(await phone.page.locator(".drawing canvas").evaluate((canvas) => getComputedStyle(canvas).touchAction), "pan-y");
    await phone.close();

    // The list knows of it, too.
    const card = list.page.getByRole("listitem").filter({ has: list.page.getByRole("heading", { name: "taught", exact: true }) });
    await card.getByTestId("present").filter({ hasText: "1 robot led now" }).waitFor();
    await list.close();

    // It is sent from the drawing, to where it goes anyway: its drive is another test's.
    const { navigations: [robot] } = await rest("maps/taught/navigations", { url: driven.url });
    const goal = robot.route.waypoints.at(-1).place_number;
    const { pose } = await rest(`maps/taught/places/${goal}`, { url: driven.url });
    const { x, y } = pose.pose.position_m;
    await page.goto(`${driven.url}/#/maps/taught?view=${x},${y},200`);
    const box = await drawing.locator("canvas").boundingBox();
    const send = drawing.getByRole("button", { name: `Send ${robot.name.split("/").at(-1)} here` });
    assert.equal(await send.count(), 0);
    // The drawing may not have moved to the link's view yet.
    await until("the place under the hand", async () => {
        await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
        return page.url().includes(`place=${goal}`);
    });
    await send.waitFor();
    const beside = await send.boundingBox();
    assert.ok(Math.abs(beside.x + beside.width / 2 - box.x - box.width / 2) < 200 && Math.abs(beside.y - box.y - box.height / 2) < 100, "far from the place");
    await accessible(page, "a robot that is led");
    const sent = page.waitForResponse((answer) => answer.request().method() === "PUT");
    await send.click();
    assert.equal((await sent).status(), 200);
    assert.deepEqual((await sent).request().postDataJSON(), { place_number: goal });
    await drawing.getByText("is sent here").waitFor();
    await drawing.locator(".beside").waitFor({ state: "detached" });

    // Two robots at one place, one of which has lost its connection.
    await page.route("**/v1/maps/taught/events", (route) => route.fulfill({ status: 503, json: {} }));
    await page.route("**/v1/maps/taught/navigations?*", async (route) => {
        const answer = await (await route.fetch()).json();
        const here = { ...robot, connected: true };
        answer.navigations = [here, { ...here, name: "maps/taught/navigations/zombie", connected: false }];
        return route.fulfill({ json: answer });
    });
    const stopped = [];
    await page.route("**/goal", (route) => {
        stopped.push([route.request().method(), new URL(route.request().url()).pathname]);
        return route.fulfill({ json: {} });
    });
    await page.reload();
    const both = await until("both robots", async () => {
        const all = await drawnRobots(page);
        return all.length === 2 && all;
    });
    assert.deepEqual(both.map(({ name, doing }) => [name, doing]), [[short, "led"], ["zombie", "gone"]]);
    assert.ok(Math.abs(both[0].x - both[1].x) >= 20, "one hides the other");
    assert.equal(await page.getByRole("button", { name: "Stop zombie" }).count(), 0);
    await page.getByRole("button", { name: `Stop ${short}` }).click();
    await until("the wish that it stops", async () => stopped.length > 0);
    assert.deepEqual(stopped, [["DELETE", `/v1/${name}/goal`]]);
    const lost = robots.getByRole("article").filter({ has: page.getByRole("heading", { name: /^zombie/ }) });
    await lost.getByText("It is not connected").waitFor();
    assert.ok(await lost.getByRole("button", { name: "Cancel its goal: stop" }).isDisabled());
    assert.ok(await lost.getByRole("button", { name: /^Send to place/ }).isDisabled());
    await accessible(page, "a robot without a connection");
    // What is beside a place can be closed, and comes again when the place is picked again.
    await drawing.getByRole("button", { name: /^Close what is beside/ }).click();
    await drawing.locator(".beside").waitFor({ state: "detached" });
    await close();
    await serveDriven();
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
    const spoken = (reason) => reason.replaceAll("_", " ").replace("below threshold", "below the threshold");
    const reason = (sequence) => spoken(frames[sequence - 1].answer.reason);
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
    assert.ok(described.includes(`place ${likely.places[0].posterior.toFixed(3)}`), described);
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

test("a link to what is gone says what is shown, and what a click opened is left by the browser's Back", async () => {
    const { page, close } = await open("#/maps/demo?session=nosuch&frame=3");
    await page.getByText("This map has no session nosuch: this is session-0.").waitFor();
    await page.goto(`${server.url}/#/maps/demo?session=session-0&frame=999999`);
    await page.getByText(/^session-0 has no frame 999999: this is frame \d+\.$/).waitFor();
    await page.goto(`${server.url}/#/maps/demo?session=session-0&frame=20`);
    const pair = page.getByRole("region", { name: "The pair" });
    await pair.getByRole("button", { name: /^Enlarge/ }).click();
    await page.locator("dialog").waitFor();
    await page.goBack();
    await page.locator("dialog").waitFor({ state: "detached" });
    assert.match(page.url(), /frame=20$/);
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
    await page.getByLabel("From odometry alone to corrected").press("End");
    const drawn = () => canvas.evaluate((canvas) => canvas.toDataURL());
    const alike = await drawn();
    await page.getByLabel("Links").selectOption({ label: "by what is left over" });
    const scale = page.getByTestId("residuals");
    await scale.waitFor();
    await until("the links in colours", async () => (await drawn()) !== alike);
    assert.match(page.url(), /links=residual/);
    // A way without a closure has nothing to disagree with.
    await scale.filter({ hasText: "every link fits to a millimetre" }).waitFor();
    await page.getByLabel("Links").selectOption({ label: "all alike" });
    await until("the links as before", async () => (await drawn()) === alike);
    // As if one of the ways had been measured half a metre too long.
    await page.route("**/graph.g2o", async (route) => {
        const lines = (await (await route.fetch()).text()).split("\n");
        const at = lines.findIndex((line) => line.startsWith("EDGE_SE2 40 ") || /^EDGE_SE2 \d+ 40 /.test(line));
        const edge = lines[at].split(" ");
        edge[3] = String(Number(edge[3]) + 0.5);
        lines[at] = edge.join(" ");
        return route.fulfill({ body: lines.join("\n"), contentType: "text/plain" });
    });
    await page.getByLabel("Links").selectOption({ label: "by what is left over" });
    await scale.filter({ hasText: "0.500 m at worst" }).waitFor();
    // By keyboard: panels above it that are still loading move it from under the mouse.
    await page.getByText("Links by what is left over").press("Enter");
    await page.getByRole("group", { name: "Table of links" }).locator("tbody tr").first().filter({ hasText: "place 40" }).filter({ hasText: "0.500" }).waitFor();
    await accessible(page, "a metric map, dark");
    await close();
});

test("colours have a legend, and closures can be hidden", async () => {
    const { page, close } = await open("#/maps/demo?colour=session");
    const canvas = page.locator(".drawing canvas");
    const legend = page.getByTestId("colours");
    await legend.filter({ hasText: "session-0" }).waitFor();
    const drawn = () => canvas.evaluate((canvas) => canvas.toDataURL());
    const closure = page.locator(".drawing .key.closure");
    await closure.waitFor();
    await until("the drawing", async () => (await colours(canvas)) > 4);
    // On a machine that is busy, panels that come later still change how much room there is.
    let shown = "";
    let same = 0;
    await until("a drawing that stays", async () => {
        const now = await drawn();
        same = now === shown ? same + 1 : 0;
        shown = now;
        return same >= 10;
    });
    await page.getByRole("combobox", { name: "Closures" }).selectOption({ label: "hidden" });
    await closure.waitFor({ state: "detached" });
    await until("a drawing without closures", async () => (await drawn()) !== shown);
    assert.match(page.url(), /closures=hidden/);
    await page.getByRole("combobox", { name: "Closures" }).selectOption({ label: "shown" });
    await until("closures as before", async () => (await drawn()) === shown);
    await page.getByRole("combobox", { name: "Colour" }).selectOption({ label: "by time" });
    await legend.filter({ hasText: /first place.*last/ }).waitFor();
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
