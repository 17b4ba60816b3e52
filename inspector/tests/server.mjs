// Real servers for the tests of the page: the demo drives one, and leaves its map to another.
import { execFile, spawn } from "node:child_process";
import { existsSync, mkdtempSync, rmSync } from "node:fs";
import { readFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { basename, join } from "node:path";
import { fileURLToPath } from "node:url";
import { promisify } from "node:util";

export const REPOSITORY = fileURLToPath(new URL("../..", import.meta.url));
const BINARIES = process.env.WAYPOST_BINARIES ?? join(REPOSITORY, "target/release");
/** A folder of files that are shown in place of those in the server's binary, as server/inspector before it is built anew. */
const ASSETS = process.env.INSPECTOR_ASSETS;
const run = promisify(execFile);

export const folder = mkdtempSync(join(tmpdir(), "waypost-inspector-"));
const running = new Set();

/** Ends what the tests started, and leaves nothing behind. */
export async function clean() {
    await Promise.all([...running].map((child) => new Promise((ended) => {
        child.once("exit", ended);
        child.kill("SIGTERM");
    })));
    rmSync(folder, { recursive: true, force: true });
}

/** Gives a browser the files of INSPECTOR_ASSETS, under the headers of the server's own. */
export async function bring(context) {
    if (!ASSETS) return;
    const known = new Map();
    await context.route(/^[^/]+\/\/[^/]+\/(#.*)?$|\/inspector\/[a-z]+\.[a-z]+$/, async (route) => {
        const url = route.request().url().replace(/#.*/, "");
        if (!known.has(url)) known.set(url, Object.fromEntries((await fetch(url)).headers));
        const body = await readFile(join(ASSETS, basename(new URL(url).pathname) || "index.html"));
        const { "content-length": _, ...headers } = known.get(url);
        await route.fulfill({ headers, body });
    });
}

/** Until `look` finds something; servers on busy machines take their time. */
export async function until(what, look, seconds = 120) {
    for (const end = Date.now() + seconds * 1000; Date.now() < end;) {
        const found = await look().catch(() => null);
        if (found) return found;
        await new Promise((later) => setTimeout(later, 100));
    }
    throw new Error(`${what} did not come within ${seconds} s`);
}

function start(program, args) {
    const child = spawn(join(BINARIES, program), args, { cwd: REPOSITORY, stdio: ["ignore", "ignore", "pipe"] });
    let said = "";
    child.stderr.on("data", (text) => (said += text));
    running.add(child);
    child.ended = new Promise((resolve, reject) => child.once("exit", (code) => {
        running.delete(child);
        if (code === 0 || child.killed) resolve();
        else reject(new Error(`${program} ended with ${code}: ${said.slice(-2000)}`));
    }));
    child.ended.catch(() => {});
    return child;
}

const addresses = async (file) => JSON.parse(await readFile(file, "utf8"));

/** The demo while it runs, with the server that it drives; `ended` once its robot has arrived. */
export async function demo() {
    const data = join(folder, "demo");
    const child = start("waypost", ["demo", "--keep-data", data]);
    const { http } = await Promise.race([
        until("the demo's server", () => addresses(join(data, "ready.json"))),
        child.ended.then(() => Promise.reject(new Error("the demo ended before its server was there"))),
    ]);
    return { url: `http://${http}`, data, ended: child.ended };
}

/** A server on a map of so many places in metres, in one drive to and fro, of words that are drawn. */
export async function grown(places, kept = process.env.LARGE_DATA ?? join(folder, "grown")) {
    if (!existsSync(kept)) {
        const asked = ["--places", places, "--words", 10_000, "--metres-apart", 2, "--rate-hz", 25, "--seconds", 2];
        await start("waypost-eval", ["load", "growth", ...asked.map(String), "--keep-data", kept]).ended;
    }
    return serve(join(kept, "data"));
}

/** What REST answers, as it must. */
export const rest = async (path, { url, token, ...init } = {}) => {
    const headers = { ...init.headers, ...(token && { authorization: `Bearer ${token}` }) };
    const answer = await fetch(`${url}/v1/${path}`, { ...init, headers });
    if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
    return answer.json();
};

/** A server on a folder of data, with the command line for it. */
export async function serve(data) {
    const ready = join(folder, `ready-${Math.random().toString(36).slice(2)}.json`);
    const free = ["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0"];
    start("waypost-server", ["--data-dir", data, "--ready-file", ready, ...free]);
    const { grpc, http } = await until("a server", () => addresses(ready));
    const call = async (token, ...args) => {
        const known = token ? ["--token", token] : [];
        return (await run(join(BINARIES, "waypost"), ["--server", `http://${grpc}`, ...known, ...args], { cwd: REPOSITORY })).stdout;
    };
    return { url: `http://${http}`, call };
}
