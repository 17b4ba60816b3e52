// What people say of a pair: a loop closure is withdrawn, told wherever it shows, and had back.
import assert from "node:assert/strict";
import { test } from "node:test";
import { accessible, closingFrame, open, rest } from "./browser.mjs";
import { until } from "./server.mjs";

test("a loop closure is withdrawn by who looks at the pair, and that is undone", async () => {
    const closing = await closingFrame();
    const before = await rest("maps/demo?view=full");
    const { page, close } = await open(`#/maps/demo?session=session-0&frame=${closing}`);
    const pair = page.getByRole("region", { name: "The pair" });
    const wrong = pair.getByRole("button", { name: "Not the same place" });
    await wrong.click();
    const question = page.getByRole("dialog", { name: `Withdraw the loop closure of frame ${closing}?` });
    await question.waitFor();
    await accessible(page, "whether to withdraw");
    await page.keyboard.press("Escape");
    await question.waitFor({ state: "detached" });
    assert.deepEqual((await rest("maps/demo/corrections")).corrections, []);

    await wrong.click();
    await question.getByRole("button", { name: "Withdraw it" }).click();
    await pair.getByTestId("correction").filter({ hasText: "withdrawn by somebody without a token" }).waitFor();
    const [said] = (await rest("maps/demo/corrections")).corrections;
    assert.equal(said.frame.sequence, closing);
    assert.equal(said.undone, null);
    assert.equal(await wrong.count(), 0);
    await page.getByText(`${before.loop_closures} loop closures, 1 withdrawn`).waitFor();
    const table = page.getByRole("region", { name: "Loop closures" });
    await table.getByRole("row").filter({ hasText: `session-0 / ${closing}` }).filter({ hasText: "withdrawn" }).waitFor();
    await page.getByTestId("cursor").filter({ hasText: "closure withdrawn" }).waitFor();
    const picture = await (await fetch(`${page.url().split("/#")[0]}/v1/${said.frame.session}/frames/${closing}/picture`)).text();
    assert.match(picture, /withdrawn by somebody without a token/);
    await accessible(page, "a withdrawn closure");

    await pair.getByRole("button", { name: "Undo it" }).click();
    await page.getByRole("dialog", { name: `Undo what was said of frame ${closing}?` }).getByRole("button", { name: "Undo it" }).click();
    await wrong.waitFor();
    assert.equal(await pair.getByTestId("correction").count(), 0);
    await until("the map as it was", async () => (await rest("maps/demo?view=full")).state_hash === before.state_hash);
    assert.notEqual((await rest("maps/demo/corrections")).corrections[0].undone, null);
    await close();
});

test("two frames are said to be of one place, and what the server refuses is told in its words", async () => {
    const before = await rest("maps/demo?view=full");
    const { frames } = await rest("maps/demo/sessions/session-0/frames?page_size=200");
    const missed = frames.find(({ answer }) => {
        const candidate = answer.match ?? answer.best_candidate;
        return answer.reason !== "loop_closure" && answer.place_number !== null && candidate && candidate.place_number !== answer.place_number;
    });
    assert.ok(missed, "no frame of the demo has a candidate that was not taken");
    const sequence = Number(missed.name.split("/").at(-1));
    const { place_number, frame } = missed.answer.match ?? missed.answer.best_candidate;
    // What is said is said of the place that is shown, whichever it is.
    const other = place_number === 0 ? 1 : 0;
    const { page, close } = await open(`#/maps/demo?session=session-0&frame=${sequence}&beside=${other}`);
    const pair = page.getByRole("region", { name: "The pair" });
    await pair.getByRole("button", { name: "The same place" }).click();
    const [first] = (await rest(`maps/demo/places/${other}`)).frames;
    await page.getByRole("dialog", { name: `Was frame ${sequence} at place ${other}?` }).getByText(`with frame ${first.sequence} of session-0`).waitFor();
    await page.keyboard.press("Escape");
    await page.goto(`${page.url().split("#")[0]}#/maps/demo?session=session-0&frame=${sequence}&beside=${place_number}`);
    await pair.getByText(`beside place ${place_number}`).waitFor();
    await pair.getByRole("button", { name: "The same place" }).click();
    const question = page.getByRole("dialog", { name: `Was frame ${sequence} at place ${place_number}?` });
    await question.getByText(`with frame ${frame.sequence} of session-0`).waitFor();
    await question.getByRole("button", { name: "Link the places" }).click();
    const said = pair.getByTestId("correction").filter({ hasText: "confirmed" });
    await said.waitFor();
    assert.match(await said.textContent(), new RegExp(`to be of one place with frame ${frame.sequence} of session-0 by somebody without a token`));
    assert.equal((await rest("maps/demo")).links, before.links + 1);

    // Another page undoes it first.
    await said.getByRole("button", { name: "Undo it" }).click();
    const [confirmed] = (await rest("maps/demo/corrections")).corrections.filter(({ undone }) => undone === null);
    await rest(`${confirmed.name}/undo`, { method: "POST" });
    const undo = page.getByRole("dialog", { name: `Undo what was said of frame ${sequence}?` });
    await undo.getByRole("button", { name: "Undo it" }).click();
    await undo.getByText("list its corrections to see what there is").waitFor();
    assert.equal((await rest("maps/demo?view=full")).state_hash, before.state_hash);
    await close();
});
