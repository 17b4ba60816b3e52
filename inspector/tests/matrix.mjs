// The match matrix: drawn by tiles, pointed at, opened by hand and by keyboard, shared by its link.
import assert from "node:assert/strict";
import { test } from "node:test";
import { accessible, colours, open, PHONE, rest, server } from "./browser.mjs";
import { until } from "./server.mjs";

const matrixOf = (page) => page.getByRole("region", { name: "Match matrix" });

/** Once all tiles that are seen are there. */
const complete = (canvas) => until("all tiles", async () => (await canvas.getAttribute("data-complete")) === "true" && (await colours(canvas)) > 20);

/** The shade of a cell, as the server's tile has it. */
async function shade(page, path, row, column) {
    return page.evaluate(async ({ path, row, column }) => {
        const image = await createImageBitmap(await (await fetch(path)).blob());
        const canvas = new OffscreenCanvas(image.width, image.height);
        const context = canvas.getContext("2d");
        context.drawImage(image, 0, 0);
        return context.getImageData(column, row, 1, 1).data[0];
    }, { path, row, column });
}

test("the match matrix is drawn, pointed at, and opens the pair of a cell by hand and by keyboard", async () => {
    const { page, close } = await open("#/maps/demo");
    const panel = matrixOf(page);
    await panel.getByRole("button", { name: "Compare the places" }).click();
    const canvas = panel.locator("canvas");
    await complete(canvas);
    const matrix = await rest("maps/demo/matrix");
    const { places, loop_closures } = await rest("maps/demo");
    assert.equal(matrix.rows.place_numbers.length, places);
    const closures = matrix.marks.filter(({ kind }) => kind === "loop_closure");
    assert.ok(closures.length > 0 && closures.length <= loop_closures, `${closures.length} of ${loop_closures}`);
    assert.match(await canvas.getAttribute("aria-label"), new RegExp(`${places} places by ${places} places`));
    const told = panel.getByTestId("cell");
    await accessible(page, "the match matrix");

    // A cell in the middle of the link's picture is the one under the hand.
    const { row, column } = closures[0];
    await page.goto(`${server.url}/#/maps/demo?matrix=.&cells=${column + 0.5},${-row - 0.5},20`);
    await complete(canvas);
    await canvas.scrollIntoViewIfNeeded();
    const middle = async () => {
        const box = await canvas.boundingBox();
        return [box.x + box.width / 2, box.y + box.height / 2];
    };
    await until("the cell under the hand", async () => {
        await page.mouse.move(...await middle());
        return /a loop was closed between them/.test(await told.textContent());
    });
    const words = await told.textContent();
    const nats = (matrix.full_shade_nats * (await shade(page, "/v1/maps/demo/matrix/tiles/0/0/0", row, column))) / 255;
    const shown = nats === 0 ? "nothing speaks for it" : `${nats.toFixed(nats < 10 ? 1 : 0)} nats`;
    assert.ok(words.includes(`place ${row} (session-0, frame`) && words.includes(`place ${column} (`) && words.includes(shown), words);
    await page.mouse.click(...await middle());
    const [later, earlier] = [Math.max(row, column), Math.min(row, column)];
    const pair = page.getByRole("region", { name: "The pair" });
    await pair.getByText(`beside place ${earlier}`).waitFor();
    assert.ok(page.url().includes(`place=${later}&beside=${earlier}`) && page.url().includes(`cell=${row}%2C${column}`), page.url());
    const [frame] = (await rest(`maps/demo/places/${later}`)).frames;
    await pair.getByRole("heading", { name: `Frame ${frame.sequence}` }).waitFor();
    await until("both images", () => pair.locator("img").evaluate((image) => image.naturalWidth > 300));
    assert.match(await pair.locator("img").getAttribute("alt"), new RegExp(`the frame of place ${earlier} `));

    // By keyboard: one cell further, and its pair.
    await canvas.focus();
    await page.keyboard.press("ArrowLeft");
    await until("the next cell", async () => page.url().includes(`cell=${row}%2C${column - 1}`));
    await page.keyboard.press("Enter");
    const next = [row, column - 1];
    if (next[0] !== next[1]) await pair.getByText(`beside place ${Math.min(...next)}`).waitFor();
    await page.keyboard.press("-");
    await until("the link of what is seen", async () => /cells=/.test(page.url()) && !/,20(&|$)/.test(decodeURIComponent(page.url())));
    await page.keyboard.press("0");
    await until("the whole matrix", async () => !page.url().includes("cells="));

    // The link is enough for somebody else.
    const other = await open(page.url().slice(server.url.length + 1), { colorScheme: "dark" });
    await complete(matrixOf(other.page).locator("canvas"));
    await matrixOf(other.page).getByTestId("cell").filter({ hasText: `place ${row} ` }).waitFor();
    await accessible(other.page, "the match matrix, dark");
    await other.close();
    await panel.getByRole("button", { name: "Close" }).click();
    await until("the map alone", async () => !page.url().includes("matrix"));
    await close();
});

test("a map is compared with another of its model, on a phone too, and an empty one says so", async () => {
    const { model } = await rest("maps/demo");
    const bare = model.slice("models/".length);
    await server.call(null, "map", "create", "bare", "--model", bare);
    const { page, close } = await open("#/maps/bare?matrix=.", { viewport: PHONE });
    await matrixOf(page).getByText("This map has no places yet, so there is nothing to compare.").waitFor();
    await accessible(page, "the matrix of an empty map");

    const { maps } = await rest("maps");
    const others = maps.filter((map) => map.model === model && map.name !== "maps/demo").map(({ name }) => name.slice(5));
    const filled = maps.find((map) => map.model === model && map.name !== "maps/demo" && map.places > 0);
    await page.goto(`${server.url}/#/maps/demo?matrix=.`);
    const panel = matrixOf(page);
    await complete(panel.locator("canvas"));
    const choice = panel.getByLabel("Against");
    assert.deepEqual(await choice.locator("option").allTextContents(), ["itself", ...others]);
    await choice.selectOption("bare");
    await panel.getByText("The map bare has no places yet").waitFor();
    if (filled) {
        const name = filled.name.slice(5);
        await choice.selectOption(name);
        await complete(panel.locator("canvas"));
        const { rows, columns, marks } = await rest(`maps/demo/matrix?against=${name}`);
        assert.deepEqual(marks, []);
        await page.goto(`${server.url}/#/maps/demo?matrix=${name}&cell=3,2`);
        const across = panel.locator(".across");
        await across.getByText(`place ${rows.place_numbers[3]} of demo`).waitFor();
        await across.getByText(`place ${columns.place_numbers[2]} of ${name}`).waitFor();
        const enlarge = panel.getByRole("button", { name: new RegExp(`^Enlarge: Place ${rows.place_numbers[3]} of demo beside place`) });
        await until("the two places side by side", () => enlarge.locator("img").evaluate((image) => image.naturalWidth > 1000));
        await enlarge.click();
        await page.getByRole("dialog").locator("img").waitFor();
        await accessible(page, "two places of two maps");
        await page.keyboard.press("Escape");
    }
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok(wide <= 0, `the matrix is ${wide} px wider than a phone`);
    await accessible(page, "the matrix on a phone");
    const refused = await fetch(`${server.url}/v1/maps/demo/matrix?against=nowhere`);
    assert.equal(refused.status, 404);
    await close();
    await server.call(null, "map", "rm", "bare", "--yes");
});

test("a tile that was refused is asked for again, without a hand on the page", async () => {
    const { page, close } = await open("#/maps");
    let asked = 0;
    await page.route("**/matrix/tiles/**", (route) => (asked++ === 0 ? route.fulfill({ status: 503, body: "" }) : route.continue()));
    await page.goto(`${server.url}/#/maps/demo?matrix=.`);
    await complete(matrixOf(page).locator("canvas"));
    assert.ok(asked > 1, `${asked} tiles were asked for`);
    await close();
});
