// What the server is asked: typed by its own description, with the token that the person gave.
import type { components } from "./rest_types";
import { parse, type Exact } from "./sequence";

export type Schemas = Exact<components["schemas"]>;
export type WayMap = Schemas["Map"];
export type Place = Schemas["Place"];
export type Session = Schemas["Session"];
export type FrameAnswer = Schemas["FrameAnswer"];
export type FrameRecord = Schemas["FrameRecord"];
export type Explanation = Schemas["FrameExplanation"];
export type LoopClosure = Schemas["LoopClosure"];
export type Navigation = Schemas["Navigation"];
export type AppearanceGraph = Schemas["AppearanceGraph"];
export type Caller = Schemas["Caller"];
export type Job = Schemas["Job"];
export type Merge = Schemas["Merge"];
export type Model = Schemas["Model"];
export type OpenStream = Schemas["OpenStream"];
export type Token = Schemas["Token"];

/** What the server refused, in its own words. */
export class Refusal extends Error {
    constructor(readonly status: number, readonly code: string, message: string) {
        super(message);
    }
}

const TOKEN = "waypost-token";
let tokenWanted: () => void = () => {};
let tokensChange = false;

/** Whom to call when the server asks for a token. */
export function whenTokenWanted(call: () => void) {
    tokenWanted = call;
}

export const token = {
    get: () => sessionStorage.getItem(TOKEN),
    set: (secret: string) => sessionStorage.setItem(TOKEN, secret),
    forget: () => sessionStorage.removeItem(TOKEN),
};

async function ask(path: string, init: RequestInit = {}): Promise<Response> {
    const headers = new Headers(init.headers);
    const secret = token.get();
    if (secret) headers.set("authorization", `Bearer ${secret}`);
    let answer: Response;
    try {
        // Without credentials the browser does not ask for a password by itself.
        answer = await fetch(path, { ...init, headers, credentials: "omit" });
    } catch (error) {
        if (init.signal?.aborted) throw error;
        throw new Refusal(0, "unreachable", "The server does not answer. Is it running, and reachable from here?");
    }
    if (answer.ok) return answer;
    // Who makes the first token has none for a moment: what is asked meanwhile is no reason to ask for one.
    if (answer.status === 401 && !tokensChange && secret === token.get()) tokenWanted();
    const body: unknown = await answer.json().catch(() => null);
    const { code, message } = (body as Schemas["ErrorBody"] | null)?.error ?? {
        code: "unknown",
        message: `The server answered ${answer.status}.`,
    };
    throw new Refusal(answer.status, code, message);
}

/** An answer that is read while it comes. */
export function open(path: string, headers: HeadersInit, signal: AbortSignal): Promise<Response> {
    return ask(path, { headers, signal });
}

export async function get<T>(path: string, signal?: AbortSignal): Promise<T> {
    return parse<T>(await text(path, signal));
}

export async function text(path: string, signal?: AbortSignal): Promise<string> {
    return (await ask(path, signal ? { signal } : {})).text();
}

export async function blob(path: string, signal?: AbortSignal): Promise<Blob> {
    return (await ask(path, signal ? { signal } : {})).blob();
}

/** The streams of robots that are open into a map, or into all of them. */
export async function streams(map: string, signal: AbortSignal): Promise<OpenStream[]> {
    const only = map && `?map=${encodeURIComponent(map)}`;
    return (await get<Schemas["ListOpenStreamsResponse"]>(`/v1/streams${only}`, signal)).streams;
}

/** Changes something: POST, PUT and PATCH with a body, DELETE without. */
export async function change<T>(method: "POST" | "PUT" | "PATCH" | "DELETE", path: string, body?: unknown): Promise<T> {
    const json = { "content-type": "application/json" };
    const answer = await ask(path, body === undefined ? { method } : { method, headers: json, body: JSON.stringify(body) });
    return parse<T>(await answer.text());
}

/** Makes a token. The first one is taken by this page itself: from then on the server serves nobody without one. */
export async function createToken(wanted: Schemas["CreateToken"]): Promise<Schemas["CreateTokenResponse"]> {
    tokensChange = true;
    try {
        const made = await change<Schemas["CreateTokenResponse"]>("POST", "/v1/tokens", wanted);
        if (token.get() === null) token.set(made.secret);
        return made;
    } finally {
        tokensChange = false;
    }
}

/** Gives a token a new secret, which this page takes where the token is its own. */
export async function rotateToken({ name }: Token, overlap_s: number, own: boolean): Promise<Schemas["RotateTokenResponse"]> {
    tokensChange = own;
    try {
        const rotated = await change<Schemas["RotateTokenResponse"]>("POST", `${at(name)}/rotate`, { overlap_s });
        if (own) token.set(rotated.secret);
        return rotated;
    } finally {
        tokensChange = false;
    }
}

/** Sends a file as it lies on the disk. */
export async function send<T>(path: string, file: Blob): Promise<T> {
    const answer = await ask(path, { method: "POST", headers: { "content-type": "application/octet-stream" }, body: file });
    return parse<T>(await answer.text());
}

/** Puts what is at a path among the person's downloads. A link sends no token: with one, it is fetched and then kept. */
export async function download(path: string, name: string) {
    const url = token.get() === null ? null : URL.createObjectURL(await blob(path));
    const link = document.createElement("a");
    link.href = url ?? path;
    link.download = name;
    link.click();
    if (url) setTimeout(() => URL.revokeObjectURL(url), 60_000);
}

const PAGE_SIZE = 1000;

/** The pages of a list, one after the other. */
export async function* pages<K extends string, T>(path: string, key: K, signal?: AbortSignal, size = PAGE_SIZE, asked: Record<string, number | string> = {}) {
    const only = Object.entries(asked).map(([name, value]) => `&${name}=${value}`).join("");
    for (let next = "", first = true; first || next; first = false) {
        const more = next ? `&page_token=${encodeURIComponent(next)}` : "";
        const page = await get<Record<K, T[]> & { next_page_token: string }>(`${path}?page_size=${size}${only}${more}`, signal);
        yield page[key] as T[];
        next = page.next_page_token;
    }
}

/** A list as a whole, of at most `most` elements where that is given. */
export async function all<K extends string, T>(path: string, key: K, signal?: AbortSignal, most = Infinity, asked: Record<string, number | string> = {}) {
    const found: T[] = [];
    for await (const page of pages<K, T>(path, key, signal, PAGE_SIZE, asked)) {
        for (const one of page) found.push(one);
        if (found.length >= most) break;
    }
    return found;
}

/** The last part of a resource's name, as in `maps/demo/sessions/MONDAY`. */
export function short(name: string): string {
    return name.slice(name.lastIndexOf("/") + 1);
}

/** The path of a resource: each part of its name percent-encoded. */
export function at(name: string): string {
    return `/v1/${name.split("/").map(encodeURIComponent).join("/")}`;
}
