// Who may do what.
import assert from "node:assert/strict";
import { join } from "node:path";
import { test } from "node:test";
import { accessible, closingFrame, cursor, open, PHONE, rest, server } from "./browser.mjs";
import { folder, serve, until } from "./server.mjs";

test("the first token is an admin's, is shown once, and is the page's own from then on", async () => {
    const fresh = await serve(join(folder, "fresh"));
    await fresh.call(null, "model", "rm", "shipped", "--yes");
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
    await fresh.call(admin, "token", "create", "scout", "--role", "robot", "--map", "hall", "--max-sessions", "3", "--max-kept-mib", "2048");
    await fresh.call(admin, "token", "limit", "scout", "--max-frames-per-second", "0.5", "--lift", "sessions");
    await tokens.getByLabel("Name of a new token").fill("reader");
    await tokens.getByRole("button", { name: "Make a token" }).click();
    await shown.getByText("The secret of reader.").waitFor();
    const robot = await shown.locator("code").textContent();
    assert.ok(!(await tokens.textContent()).includes(admin), "a secret is shown again");
    const limited = tokens.getByRole("row").filter({ hasText: "scout" });
    await limited.getByText("the maps hall; 0.5 frames a second; 0 of 2048 MiB kept").waitFor();
    await tokens.getByRole("row").filter({ hasText: "operator" }).getByText("nothing").waitFor();
    const who = await rest("whoami", { url: fresh.url, token: robot });
    assert.deepEqual(who, {
        token: "tokens/reader", role: "robot", asks_for_token: true,
        abilities: ["read", "localize", "stream", "navigate"], maps: [], expire_time_ns: null,
        quotas: { max_maps: null, max_sessions: null, max_frames_per_second: null, max_kept_mib: null },
    });

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
    await other.page.getByRole("link", { name: "Merges" }).click();
    await other.page.getByText("No maps were merged yet.").waitFor();
    assert.equal(await other.page.getByRole("region", { name: "Merge maps" }).count(), 0);

    await tokens.getByRole("button", { name: "Delete the token reader" }).click();
    await page.getByRole("dialog").getByRole("textbox").fill("reader");
    await page.getByRole("dialog").getByRole("button", { name: "Delete the token" }).click();
    await tokens.getByRole("rowheader", { name: "reader" }).waitFor({ state: "detached" });
    await other.page.getByRole("heading", { name: "This server asks for a token" }).waitFor();
    await other.close();
    await close();
});

test("a token is made with limits, limited otherwise, and given another secret", async () => {
    const fresh = await serve(join(folder, "limited"));
    const admin = secretOf(await fresh.call(null, "token", "create", "operator", "--role", "admin"));
    const { page, close } = await open("#/operations", { url: fresh.url });
    await page.getByLabel("Token").fill(admin);
    await page.getByRole("button", { name: "Log in" }).click();
    const tokens = page.getByRole("region", { name: "Tokens" });
    await tokens.getByLabel("Name of a new token").fill("scout");
    await tokens.getByText("Limit it").click();
    await tokens.getByLabel("Maps that it reaches").fill("hall, floor2-*");
    await tokens.getByLabel("Days that it is good for").fill("0.5");
    await tokens.getByLabel("may navigate").uncheck();
    await tokens.getByLabel("Most sessions").fill("3");
    await accessible(page, "a token that is limited");
    await tokens.getByRole("button", { name: "Make a token" }).click();
    await tokens.getByText("The secret of scout.").waitFor();
    const first = await tokens.locator(".secret code").textContent();
    const row = tokens.getByRole("row").filter({ hasText: "scout" });
    await row.getByText(/^the maps floor2-\*, hall; may read, localize, stream; 0 of 3 sessions; until /).waitFor();
    const known = async () => (await rest("tokens", { url: fresh.url, token: admin })).tokens.find(({ name }) => name === "tokens/scout");
    const { create_time_ns, expire_time_ns } = await known();
    assert.ok(Math.abs((expire_time_ns - create_time_ns) / 1e9 - 43_200) < 60, "half a day");

    await row.getByRole("button", { name: "Limits of the token scout" }).click();
    const limiting = page.getByRole("dialog", { name: "Limits of scout" });
    assert.equal(await limiting.getByLabel("Most sessions").inputValue(), "3");
    await limiting.getByLabel("Most sessions").fill("");
    await limiting.getByLabel("Most frames a second").fill("2.5");
    await accessible(page, "the limits of a token");
    await limiting.getByRole("button", { name: "Change the limits" }).click();
    await row.getByText(/stream; 2.5 frames a second; until /).waitFor();
    const { quotas } = await known();
    assert.deepEqual(quotas, { max_maps: null, max_sessions: null, max_frames_per_second: 2.5, max_kept_mib: null });

    await row.getByRole("button", { name: "New secret for the token scout" }).click();
    const rotating = page.getByRole("dialog", { name: "A new secret for scout" });
    await rotating.getByLabel("Hours").fill("0");
    await rotating.getByRole("button", { name: "Make a new secret" }).click();
    await until("another secret", async () => (await tokens.locator(".secret code").textContent()) !== first);
    const second = await tokens.locator(".secret code").textContent();
    const who = async (token) => (await fetch(`${fresh.url}/v1/whoami`, { headers: { authorization: `Bearer ${token}` } })).status;
    assert.deepEqual([await who(first), await who(second)], [401, 200]);
    // The page goes on with its own new secret.
    await tokens.getByRole("button", { name: "New secret for the token operator" }).click();
    await page.getByRole("dialog").getByLabel("Hours").fill("0");
    await page.getByRole("dialog").getByRole("button", { name: "Make a new secret" }).click();
    await tokens.getByText("The secret of operator.").waitFor();
    assert.equal(await who(admin), 401);
    await page.reload();
    await tokens.getByText("(this page’s)").waitFor();
    await close();
});

const secretOf = (text) => text.match(/waypost_\w+/)[0];

/** The secret of the demo's server, once it asks for one. */
let admins;

// Last, for from here on this server asks for tokens.
test("a server with tokens asks for one, and shows what its holder may see", async () => {
    const admin = secretOf(await server.call(null, "token", "create", "operator", "--role", "admin"));
    admins = admin;
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
    await page.getByTestId("live").filter({ hasText: "live" }).waitFor();
    assert.equal(await page.getByRole("button", { name: "Delete the session" }).count(), 0);
    assert.equal(await page.getByRole("button", { name: "Not the same place" }).count(), 0);
    await page.reload();
    await cursor(page).filter({ hasText: `frame ${closing}` }).waitFor();
    await server.call(admin, "token", "rm", "reader", "--yes");
    await page.getByRole("heading", { name: "This server asks for a token" }).waitFor();
    await page.getByLabel("Token").fill(admin);
    await page.getByRole("button", { name: "Log in" }).click();
    await cursor(page).filter({ hasText: `frame ${closing}` }).waitFor();
    await page.getByRole("button", { name: "Delete the session" }).waitFor();
    await page.getByRole("button", { name: "Not the same place" }).waitFor();
    await page.getByRole("link", { name: "Maps" }).click();
    const coming = page.waitForEvent("download");
    await page.getByRole("button", { name: "Export the map demo" }).click();
    assert.equal((await coming).suggestedFilename(), "demo.waypost-map");
    await page.getByRole("button", { name: "Log out" }).click();
    await page.getByRole("heading", { name: "This server asks for a token" }).waitFor();
    assert.equal(await page.evaluate(() => sessionStorage.length), 0);
    await close();
});

test("who may only read sees who withdrew a loop closure, and can neither do so nor undo it", async () => {
    const admin = secretOf(await server.call(admins, "token", "create", "anna", "--role", "admin"));
    const reader = secretOf(await server.call(admin, "token", "create", "onlooker", "--role", "reader"));
    const closing = await closingFrame({ token: admin });
    const before = await rest("maps/demo?view=full", { token: admin });
    const loggedIn = async (secret) => {
        const opened = await open(`#/maps/demo?session=session-0&frame=${closing}`);
        await opened.page.getByLabel("Token").fill(secret);
        await opened.page.getByRole("button", { name: "Log in" }).click();
        await cursor(opened.page).filter({ hasText: `frame ${closing}: loop closure` }).waitFor();
        return { ...opened, pair: opened.page.getByRole("region", { name: "The pair" }) };
    };
    const [annas, onlookers] = [await loggedIn(admin), await loggedIn(reader)];
    await annas.pair.getByRole("button", { name: "Not the same place" }).click();
    await annas.page.getByRole("dialog").getByRole("button", { name: "Withdraw it" }).click();
    const undo = annas.pair.getByRole("button", { name: "Undo it" });
    await undo.waitFor();

    await onlookers.page.reload();
    await onlookers.pair.getByTestId("correction").filter({ hasText: "withdrawn by anna" }).waitFor();
    assert.equal(await onlookers.pair.getByRole("button", { name: /Undo it|same place/ }).count(), 0);
    const [said] = (await rest("maps/demo/corrections", { token: reader })).corrections.filter(({ undone }) => undone === null);
    const headers = { authorization: `Bearer ${reader}`, "content-type": "application/json" };
    const withdraw = JSON.stringify({ withdraw: { frame: `${said.frame.session}/frames/${closing}` } });
    for (const [path, body] of [[`${said.name}/undo`, undefined], ["maps/demo/corrections", withdraw]]) {
        const refused = await fetch(`${server.url}/v1/${path}`, { method: "POST", headers, body });
        assert.equal(refused.status, 403);
        assert.match(await refused.text(), /onlooker is a reader's/);
    }

    await undo.click();
    await annas.page.getByRole("dialog").getByRole("button", { name: "Undo it" }).click();
    await annas.pair.getByRole("button", { name: "Not the same place" }).waitFor();
    assert.equal((await rest("maps/demo?view=full", { token: reader })).state_hash, before.state_hash);
    await annas.close();
    await onlookers.close();
});

test("on a phone it shows who one is, and the way out", async () => {
    const { page, close } = await open("#/maps", { viewport: PHONE });
    await page.getByLabel("Token").fill(admins);
    await page.getByRole("button", { name: "Log in" }).click();
    for (const width of [PHONE.width, 320]) {
        await page.setViewportSize({ width, height: PHONE.height });
        for (const shown of [page.locator(".who").filter({ hasText: "operator" }), page.getByRole("button", { name: "Log out" })]) {
            await shown.waitFor();
            const { x, width: wide } = await shown.boundingBox();
            assert.ok(x >= 0 && x + wide <= width, `something of the header is out of sight at ${width} px`);
        }
        const over = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
        assert.ok(over <= 0, `the page is ${over} px wider than the screen`);
    }
    await accessible(page, "who one is, on a phone");
    await close();
});
