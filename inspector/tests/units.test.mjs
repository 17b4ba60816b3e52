// Parts of the page that are functions of what they are given, without a browser.
import assert from "node:assert/strict";
import { test } from "node:test";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

/** A source of the page, as a module. */
async function source(path) {
    const { outputFiles: [file] } = await build({
        entryPoints: [fileURLToPath(new URL(`../src/${path}`, import.meta.url))],
        bundle: true, write: false, format: "esm", target: "es2022", jsx: "automatic", jsxImportSource: "preact",
    });
    return import(`data:text/javascript;base64,${Buffer.from(file.contents).toString("base64")}`);
}

const LAST = String(2n ** 63n - 1n);

test("a link keeps the number of a frame to the last digit", async () => {
    const { hash, read } = await source("link.ts");
    for (const frame of ["0", "147", "1000000000000000", "1700000000123456789", LAST]) {
        const link = read(`#/maps/hall?session=monday&frame=${frame}`);
        assert.equal(link.frame, frame);
        assert.equal(hash(link), `#/maps/hall?session=monday&frame=${frame}`);
    }
    assert.equal(read("#/maps/hall?frame=007").frame, "7");
    for (const none of ["", "-1", "1.5", "1e3", String(2n ** 63n), "12345678901234567890"]) {
        assert.equal(read(`#/maps/hall?frame=${none}`).frame, null, none);
    }
});

test("numbers of frames in the server's JSON are read to the last digit, and texts as they are", async () => {
    const { parse } = await source("sequence.ts");
    const note = "\"sequence\":1, \\\"last_sequence\":2";
    const json = `{"first_sequence":1,"last_sequence":${LAST},"frame":{"sequence":1700000000123456789,"note":${JSON.stringify(note)}},"frames":3}`;
    assert.deepEqual(parse(json), {
        first_sequence: "1", last_sequence: LAST, frame: { sequence: "1700000000123456789", note }, frames: 3,
    });
    assert.deepEqual(parse(`{"first_sequence":null}`), { first_sequence: null });
});

test("numbers of frames are in the order of numbers", async () => {
    const { compare } = await source("sequence.ts");
    const sorted = ["0", "2", "10", "1700000000123456788", "1700000000123456789", LAST];
    assert.deepEqual([...sorted].reverse().sort(compare), sorted);
    assert.equal(compare(LAST, LAST), 0);
});

test("a long session is listed in windows around the cursor, also where its numbers are stamps", async () => {
    const { windowOf } = await source("panels/steps.ts");
    const session = (first, apart, frames) => ({
        name: "maps/hall/sessions/monday", frames, first_sequence: String(first), last_sequence: String(first + BigInt(frames - 1) * apart),
    });
    assert.equal(windowOf(session(1n, 1n, 5000), "2000"), null);
    assert.deepEqual(windowOf(session(1n, 1n, 6000), null), { from: "1", until: "1501" });
    assert.deepEqual(windowOf(session(1n, 1n, 6000), "1500"), { from: "1", until: "1501" });
    assert.deepEqual(windowOf(session(1n, 1n, 6000), "1501"), { from: "1001", until: "2501" });
    const [first, apart] = [1_700_000_000_123_456_789n, 100_000_000n];
    const at = (index) => String(first + BigInt(index) * apart);
    for (const index of [0, 1, 700, 3000, 5999]) {
        const { from, until } = windowOf(session(first, apart, 6000), at(index));
        const before = (BigInt(at(index)) - BigInt(from)) / apart;
        assert.ok(before >= Math.min(index, 250) && before < 1500, `${before} frames before frame ${index}`);
        assert.ok(BigInt(until) > BigInt(at(index)));
    }
});
