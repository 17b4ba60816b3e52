// What the server works with: maps, models and jobs that come and go.
import assert from "node:assert/strict";
import { join } from "node:path";
import { test } from "node:test";
import { accessible, colours, HOSTILE, open, rest, server } from "./browser.mjs";
import { folder, serve, until } from "./server.mjs";

test("a server with nothing says how to begin; names of models are text", async () => {
    const empty = await serve(join(folder, "empty"));
    await empty.call(null, "model", "rm", "shipped", "--yes");
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
    const { servers } = await rest("cluster");
    const owner = page.getByRole("region", { name: "Servers" }).locator("tbody tr");
    assert.equal(servers.length, 1);
    const told = await owner.textContent();
    assert.ok(told.includes(servers[0].holder) && told.includes("owner") && told.includes("just now"), told);
    await page.getByText("SQLite, which has one server").waitFor();
    await accessible(page, "operations");
    await close();
});

// How several servers come to be is tested where a database of PostgreSQL is; here, how they are shown.
test("servers in reserve, standbys and warnings are shown", async () => {
    const { page, close } = await open("#/");
    const server = (role, holder, more) => ({
        role, holder, version: "0.1.0", grpc_address: `${holder}:7600`, http_address: `${holder}:7601`, cores: 4, images: 12, silent_s: 0.4, ...more,
    });
    const cluster = {
        database: "postgres", epoch: 3, servers: [server("owner", "one"), server("reserve", HOSTILE, { images: null, silent_s: 21.4 })],
        standbys: [{ name: "two", state: "streaming", sync_state: "quorum", lag_bytes: 2048 }], warnings: ["PostgreSQL's fsync is off: …"],
        load: { open_maps: 1, open_streams: 2, robots_led: 0, images_waiting: 5, robots_in_line: 0, requests_waiting: 1, jobs_running: 0 },
    };
    await page.route("**/v1/cluster", (route) => route.fulfill({ json: cluster }));
    await page.getByRole("link", { name: "Operations" }).click();
    const region = page.getByRole("region", { name: "Servers" });
    await region.getByText("PostgreSQL, epoch 3. Waiting: 5 images, 1 request").waitFor();
    const gone = await region.getByRole("row").filter({ hasText: HOSTILE }).textContent();
    assert.ok(gone.includes("not asked") && gone.includes("21 s ago"), gone);
    await region.getByRole("row").filter({ hasText: "quorum" }).getByText("2.0 kB").waitFor();
    await region.getByText("fsync is off").waitFor();
    await accessible(page, "servers");
    await close();
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
    await bare.call(null, "model", "rm", "shipped", "--yes");
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
    await models.getByRole("button", { name: "Rename the model site" }).click();
    const naming = other.page.getByRole("dialog", { name: /^Rename the model/ });
    assert.equal(await naming.getByLabel("Name").inputValue(), "site");
    await accessible(other.page, "a model to be renamed");
    await naming.getByLabel("Name").fill("shipped site");
    await naming.getByRole("button", { name: "Rename it" }).click();
    await models.getByRole("cell", { name: "shipped site", exact: true }).waitFor();
    assert.equal((await rest("models", { url: bare.url })).models[0].display_name, "shipped site");
    await models.getByRole("button", { name: "Delete the model shipped site" }).click();
    await other.page.getByRole("dialog").getByRole("textbox").fill("shipped site");
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
    // What it refuses is counted by reason, from here on.
    const refused = page.getByRole("region", { name: "Refused" });
    await refused.getByText(/since the server began/i).first().waitFor();
    for (const map of ["nowhere", "nowhere-else"]) assert.equal((await fetch(`${server.url}/v1/maps/${map}`)).status, 404);
    const counted = refused.getByRole("row").filter({ has: page.getByRole("rowheader", { name: "REST GET /v1/maps/{map}", exact: true }) }).filter({ hasText: "404, not there" });
    await counted.getByRole("cell", { name: "2", exact: true }).first().waitFor();
    const log = refused.getByRole("group", { name: "Log of refusals" });
    const told = log.getByRole("row").filter({ has: page.getByRole("rowheader", { name: "GET /v1/maps/nowhere-else", exact: true }) });
    await told.getByText(/^there is no map nowhere-else/).waitFor();
    await told.getByRole("cell", { name: "127.0.0.1", exact: true }).waitFor();

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
