// Maps that become one: looked for, seen, and decided by a person.
import assert from "node:assert/strict";
import { test } from "node:test";
import { accessible, colours, open, PATIENCE_MS, PHONE, rest, server } from "./browser.mjs";
import { until } from "./server.mjs";

const state = (page, words) => page.locator(".title").getByTestId("state").filter({ hasText: words }).waitFor({ timeout: 2 * PATIENCE_MS });

const exists = async (map) => (await fetch(`${server.url}/v1/maps/${map}`)).ok;

/** Two maps of the same places in metres, and the numbers of the merges from here on. */
async function days() {
    const { model } = await rest("maps/taught");
    for (const [day, ...route] of [["monday"], ["tuesday", "--route", "teach"]]) {
        await server.call(null, "map", "create", day, "--model", model.slice(7));
        await server.call(null, "simulate", "--map", day, "--world", "office", "--session", day, ...route);
    }
}

test("a merge is looked for, shown with its evidence, and changes nothing before it is committed", async () => {
    await days();
    const { page, close } = await open("#/merges");
    await page.getByText("No maps were merged yet.").waitFor();
    const form = page.getByRole("region", { name: "Merge maps" });
    const look = form.getByRole("button", { name: "Look for the overlap" });
    assert.ok(await look.isDisabled());
    await form.getByLabel("monday").check();
    await form.getByLabel("Into").fill("week");
    await look.click();
    await form.getByText("name two maps or more").waitFor();
    await form.getByLabel("tuesday").check();
    await form.getByLabel("Matches that must agree").fill("6");
    await until("the link of what is chosen", async () => /maps=monday%2Ctuesday&into=week/.test(page.url()));
    await accessible(page, "the wish for a merge");
    // Without a search they lie on each other as a person says.
    await form.getByRole("button", { name: "On each other" }).click();
    const byHand = page.getByRole("region", { name: "The maps on each other" });
    const before = await Promise.all(["monday", "tuesday"].map(async (day) => (await rest(`maps/${day}`)).places));
    await until("both maps", async () => (await byHand.locator("canvas").getAttribute("data-drawn")) === String(before[0] + before[1]));
    await byHand.getByLabel("tuesday x, m").fill("2.5");
    await byHand.getByLabel("tuesday turned, °").fill("90");
    await byHand.getByLabel("tuesday turned, °").press("Enter");
    await until("the link of how they lie", async () => decodeURIComponent(page.url()).includes("laid=2.5,0,90"));
    await accessible(page, "maps on each other by hand");
    await form.getByRole("button", { name: "On each other" }).click();
    await byHand.waitFor({ state: "detached" });
    await look.click();
    await page.getByRole("heading", { name: /^Merge \d+$/ }).waitFor();
    const number = page.url().match(/merges\/(\d+)$/)[1];
    await state(page, "proposed");
    assert.equal(await exists("week"), false);

    const merge = await rest(`merges/${number}`);
    const [{ map, overlap }] = merge.sources;
    const evidence = page.getByRole("region", { name: `Evidence for ${map.slice(5)}` });
    const words = await evidence.textContent();
    for (const shown of [
        `agree${overlap.agreeing_matches}`, `all other matches${overlap.rejected_matches}`, `next best way${overlap.rival_matches} match`,
        `fused places${overlap.fused_places}`, `${overlap.confirmed_places} of ${overlap.overlapping_places} place`,
    ]) assert.ok(words.includes(shown), `${words} has no ${shown}`);
    const strongest = overlap.strongest_matches[0];
    await evidence.getByRole("link", { name: `place ${strongest.source_place_number}` }).first().waitFor();
    await until("the images of a match", () => evidence.locator("img").first().evaluate((image) => image.naturalWidth > 0));
    await evidence.getByRole("button", { name: `Compare place ${strongest.source_place_number} with place ${strongest.target_place_number} of the target` }).click();
    const sharing = page.getByRole("dialog", { name: new RegExp(`^Place ${strongest.source_place_number} beside place`) });
    await until("the match as a picture", () => sharing.locator("img").evaluate((image) => image.naturalWidth > 1000));
    assert.ok(decodeURIComponent(page.url()).includes(`frame=${strongest.source_frame}&beside=${strongest.target_frame}`), page.url());
    await accessible(page, "a match of a merge");
    await page.reload();
    await sharing.waitFor();
    await page.keyboard.press("Escape");
    await until("the merge alone", async () => !page.url().includes("beside="));
    await until("the picture", () => page.getByRole("region", { name: "Before and after" }).locator("img").evaluate((image) => image.naturalWidth > 300));
    const laid = page.getByRole("region", { name: "The maps on each other" });
    const canvas = laid.locator("canvas");
    const places = await Promise.all(["monday", "tuesday"].map(async (day) => (await rest(`maps/${day}`)).places));
    await until("both maps on each other", async () => (await canvas.getAttribute("data-drawn")) === String(places[0] + places[1]));
    assert.ok((await colours(canvas)) > 8);
    const legend = await laid.locator(".legend").textContent();
    assert.ok(legend.includes("monday, the base: monday") && legend.includes("tuesday: tuesday"), legend);
    const base = page.getByRole("region", { name: "The base monday" });
    await base.getByRole("link", { name: "monday" }).waitFor();
    assert.match(await base.textContent(), new RegExp(`${places[0]} places.*1 session of its own`));
    await accessible(page, "a proposed merge");

    await page.getByRole("button", { name: "Discard", exact: true }).click();
    const question = page.getByRole("dialog", { name: "Discard what was found?" });
    await question.waitFor();
    await page.keyboard.press("Escape");
    await question.waitFor({ state: "detached" });
    assert.equal((await rest(`merges/${number}`)).state, "proposed");
    await page.getByRole("button", { name: "Discard", exact: true }).click();
    await question.getByRole("button", { name: "Discard it" }).click();
    await state(page, "discarded");
    assert.equal((await rest(`merges/${number}`)).state, "discarded");
    assert.equal(await page.getByRole("button", { name: /Commit|Discard|Undo/ }).count(), 0);
    await close();
});

test("a merge is committed and undone, and a decision that comes too late is refused by the server's own sentence", async () => {
    const { page, close } = await open("#/merges?maps=monday,tuesday&into=week");
    await page.getByRole("button", { name: "Look for the overlap" }).click();
    await page.getByRole("heading", { name: /^Merge \d+$/ }).waitFor();
    const committed = page.url().match(/merges\/(\d+)$/)[1];
    await state(page, "proposed");
    await page.getByRole("button", { name: "Commit", exact: true }).click();
    await accessible(page, "the question before a merge");
    await page.getByRole("dialog").getByRole("button", { name: "Commit the merge" }).click();
    await state(page, "committed");
    assert.ok(await exists("week"));
    assert.equal((await rest(`merges/${committed}`)).state, "committed");
    await page.getByRole("link", { name: "Open the map week" }).waitFor();

    await page.getByRole("button", { name: "Undo", exact: true }).click();
    const question = page.getByRole("dialog", { name: `Undo merge ${committed}?` });
    const undo = question.getByRole("button", { name: "Undo the merge" });
    await question.getByRole("textbox").fill("wee");
    assert.ok(await undo.isDisabled());
    await question.getByRole("textbox").fill("week");
    await undo.click();
    await state(page, "undone");
    assert.equal(await exists("week"), false);

    const body = JSON.stringify({ sources: ["maps/monday", "maps/tuesday"], target: "maps/week" });
    const headers = { "content-type": "application/json" };
    const { name } = await rest("merges", { method: "POST", headers, body });
    await page.goto(`${server.url}/#/${name}`);
    await state(page, "proposed");
    await page.getByRole("button", { name: "Commit", exact: true }).click();
    await rest(`${name}/decision`, { method: "PUT", headers, body: JSON.stringify({ decision: "discard" }) });
    await page.getByRole("dialog").getByRole("button", { name: "Commit the merge" }).click();
    await page.getByRole("dialog").getByText(`${name} is discarded and cannot be committed`).waitFor();
    await close();
});

test("what a merge brings into a map that was there before is none of its own, and is drawn once", async () => {
    const before = await Promise.all(["monday", "tuesday"].map(async (day) => (await rest(`maps/${day}`)).places));
    const body = JSON.stringify({ sources: ["maps/tuesday"], target: "maps/monday" });
    const { name } = await rest("merges", { method: "POST", headers: { "content-type": "application/json" }, body });
    const { page, close } = await open(`#/${name}`);
    await state(page, "proposed");
    const drawn = () => page.getByRole("region", { name: "The maps on each other" }).locator("canvas").getAttribute("data-drawn");
    await until("both maps on each other", async () => (await drawn()) === String(before[0] + before[1]));
    await page.getByRole("button", { name: "Commit", exact: true }).click();
    await page.getByRole("dialog").getByRole("button", { name: "Commit the merge" }).click();
    await state(page, "committed");
    assert.deepEqual((await rest(name)).sources[0].sessions, ["tuesday"]);
    const { places } = await rest("maps/monday");
    assert.ok(places > before[0], "the merge has brought no place");
    const base = page.getByRole("region", { name: "The base monday" });
    await base.getByText(`${places} places`).waitFor();
    assert.match(await base.textContent(), /1 session of its own/);
    assert.deepEqual(await base.getByRole("listitem").getByRole("link").allTextContents(), ["monday"]);
    await until("each place once", async () => (await drawn()) === String(before[0] + before[1]));
    await page.getByRole("region", { name: "Evidence for tuesday" }).getByText("Its session in the target: tuesday").waitFor();
    await server.call(null, "merge", "undo", name.slice(7));
    await close();
});

test("maps without an overlap say why, and the list has every merge with what became of it", async () => {
    const { page, close } = await open("#/merges?maps=demo&into=monday", { viewport: PHONE, colorScheme: "dark" });
    await page.getByLabel("commit unseen").check();
    await page.getByRole("button", { name: "Merge them" }).click();
    await state(page, "no overlap");
    const [{ sources }] = (await rest("merges")).merges;
    // Into a map that was there before: its sessions are those of the base.
    const base = page.getByRole("region", { name: "The base monday" });
    await base.getByRole("link", { name: "monday" }).waitFor();
    const { frames } = await rest("maps/monday/sessions/monday");
    await base.getByText(`${frames} frames`).waitFor();
    await page.getByText(sources[0].no_overlap_reason).waitFor();
    assert.equal(await page.getByRole("button", { name: /Commit|Discard|Undo/ }).count(), 0);
    const wide = () => page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok((await wide()) <= 0, "a merge is wider than the screen");
    await accessible(page, "a merge without an overlap, dark, on a phone");
    await page.getByRole("link", { name: "Merges" }).click();
    const table = page.getByRole("group", { name: "Table of merges" });
    await table.waitFor();
    const { merges } = await rest("merges");
    const shown = await table.locator("tbody tr").allTextContents();
    assert.equal(shown.length, merges.length);
    merges.forEach(({ name, state, target }, at) => {
        for (const part of [name.slice(7), state.replace("_", " "), target.slice(5)]) assert.ok(shown[at].includes(part), shown[at]);
    });
    assert.ok((await wide()) <= 0, "the list of merges is wider than the screen");
    await accessible(page, "merges, dark, on a phone");
    await table.getByRole("link").first().click();
    await state(page, "no overlap");
    await close();
    for (const day of ["monday", "tuesday"]) await server.call(null, "map", "rm", day, "--yes");
});
