// Who may do what.
import assert from "node:assert/strict";
import { join } from "node:path";
import { test } from "node:test";
import { accessible, closingFrame, cursor, open, rest, server } from "./browser.mjs";
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
    await tokens.getByLabel("Name of a new token").fill("reader");
    await tokens.getByRole("button", { name: "Make a token" }).click();
    await shown.getByText("The secret of reader.").waitFor();
    const robot = await shown.locator("code").textContent();
    assert.ok(!(await tokens.textContent()).includes(admin), "a secret is shown again");
    const who = await rest("whoami", { url: fresh.url, token: robot });
    assert.deepEqual(who, {
        token: "tokens/reader", role: "robot", asks_for_token: true,
        abilities: ["read", "localize", "stream", "navigate"], maps: [], expire_time_ns: null,
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
    await page.getByTestId("live").filter({ hasText: "live" }).waitFor();
    assert.equal(await page.getByRole("button", { name: "Delete the session" }).count(), 0);
    await page.reload();
    await cursor(page).filter({ hasText: `frame ${closing}` }).waitFor();
    await server.call(admin, "token", "rm", "reader", "--yes");
    await page.getByRole("heading", { name: "This server asks for a token" }).waitFor();
    await page.getByLabel("Token").fill(admin);
    await page.getByRole("button", { name: "Log in" }).click();
    await cursor(page).filter({ hasText: `frame ${closing}` }).waitFor();
    await page.getByRole("button", { name: "Delete the session" }).waitFor();
    await page.getByRole("link", { name: "Maps" }).click();
    const coming = page.waitForEvent("download");
    await page.getByRole("button", { name: "Export the map demo" }).click();
    assert.equal((await coming).suggestedFilename(), "demo.waypost-map");
    await page.getByRole("button", { name: "Log out" }).click();
    await page.getByRole("heading", { name: "This server asks for a token" }).waitFor();
    assert.equal(await page.evaluate(() => sessionStorage.length), 0);
    await close();
});
