// What happens in a map, while it happens: the server's events, read from an answer that does not end.
// A browser's own EventSource sends no token, so the answer is fetched, and read as the HTML standard says.
import { at, open, Refusal, type Schemas } from "./rest";
import { parse } from "./sequence";

type MapEvent = Schemas["MapEvent"];

export interface Said {
    event: string;
    id: string | null;
    data: string;
}

/** The server says something every 15 s, if only that it is there. */
const SILENT_MS = 45_000;
/** An event is a few kilobytes: more is no event of this server. */
const MOST_CHARACTERS = 4_000_000;

async function soon<T>(coming: Promise<T>): Promise<T> {
    let timer = 0;
    const late = new Promise<never>((_, off) => {
        timer = window.setTimeout(() => off(new Refusal(0, "unreachable", "The server has fallen silent.")), SILENT_MS);
    });
    return Promise.race([coming, late]).finally(() => clearTimeout(timer));
}

/** The events of an answer, one after the other; only one is held at a time. */
export async function* said(body: ReadableStream<Uint8Array>): AsyncGenerator<Said> {
    const reader = body.getReader();
    const decoder = new TextDecoder();
    let text = "";
    let now: Said = { event: "message", id: null, data: "" };
    try {
        for (;;) {
            const { done, value } = await soon(reader.read());
            if (done) return;
            text += decoder.decode(value, { stream: true });
            // The last line may still come to an end; so may the \r of a \r\n.
            const lines = text.split(/\r\n|\n|\r(?!$)/);
            text = lines.pop() ?? "";
            if (text.length + now.data.length > MOST_CHARACTERS) throw new Refusal(0, "unknown", "An event was too long.");
            for (const line of lines) {
                if (line === "") {
                    if (now.data) yield { ...now, data: now.data.slice(0, -1) };
                    now = { event: "message", id: null, data: "" };
                    continue;
                }
                const [, field, given] = /^([^:]*)(?:: ?(.*))?$/s.exec(line) ?? [];
                if (field === "event") now.event = given ?? "";
                else if (field === "id") now.id = given ?? "";
                else if (field === "data") now.data += `${given ?? ""}\n`;
            }
        }
    } finally {
        // Whoever has heard enough ends the connection.
        reader.cancel().catch(() => {});
    }
}

export interface Listener {
    /** Events come from here on: what was asked for before may be out of date, and is if they are of another log. */
    renew: (anotherLog: boolean) => void;
    hear: (event: MapEvent) => void;
    /** Whether events come, and if not, why. */
    live: (live: boolean, why: Error | null) => void;
}

const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 30_000;
/** Who looks away for longer asks for the map anew: that is less than all that was missed. */
const MISSED_MS = 60_000;

/** Listens until `signal` says so, and while the page is looked at: connections are few. Goes on where it was cut off. */
export async function follow(map: string, { renew, hear, live }: Listener, signal: AbortSignal) {
    let last: string | null = null;
    let log: string | null = null;
    let pause = FIRST_PAUSE_MS;
    while (!signal.aborted) {
        const away = performance.now();
        await looked(signal);
        if (performance.now() - away > MISSED_MS) last = null;
        const connection = connected(signal);
        try {
            const headers: HeadersInit = last === null ? {} : { "last-event-id": last };
            const answer = await open(`${at(map)}/events`, headers, connection.signal);
            live(true, null);
            for await (const { event, id, data } of said(answer.body!)) {
                pause = FIRST_PAUSE_MS;
                if (event === "error") throw refusalOf(data);
                if (id !== null) {
                    // The first event has one. It names the log, and the position in it.
                    const named = id.slice(0, id.lastIndexOf("-"));
                    if (last === null) renew(log !== null && named !== log);
                    [last, log] = [id, named];
                }
                hear(parse<MapEvent>(data));
            }
        } catch (error) {
            if (signal.aborted) return;
            if (connection.signal.aborted) continue;
            live(false, error as Error);
            // Positions mean something else by now, or the map is gone.
            if (error instanceof Refusal && ["aborted", "failed_precondition", "not_found"].includes(error.code)) last = null;
        } finally {
            connection.end();
        }
        await wait(pause, signal);
        pause = Math.min(2 * pause, LONGEST_PAUSE_MS);
    }
}

function refusalOf(data: string): Refusal {
    const { status, error } = JSON.parse(data) as Schemas["ErrorBody"];
    return new Refusal(status, error.code, error.message);
}

/** A connection that ends with the page, or when nobody looks at it. */
function connected(signal: AbortSignal) {
    const ending = new AbortController();
    const end = () => ending.abort();
    const hidden = () => document.visibilityState === "hidden" && end();
    signal.addEventListener("abort", end);
    document.addEventListener("visibilitychange", hidden);
    return {
        signal: ending.signal,
        end: () => {
            end();
            signal.removeEventListener("abort", end);
            document.removeEventListener("visibilitychange", hidden);
        },
    };
}

/** Until the page is looked at, or left. */
function looked(signal: AbortSignal): Promise<void> {
    return new Promise((on) => {
        const changed = () => {
            if (document.visibilityState !== "visible" && !signal.aborted) return;
            document.removeEventListener("visibilitychange", changed);
            signal.removeEventListener("abort", changed);
            on();
        };
        document.addEventListener("visibilitychange", changed);
        signal.addEventListener("abort", changed);
        changed();
    });
}

function wait(milliseconds: number, signal: AbortSignal): Promise<void> {
    return new Promise((on) => {
        const over = () => {
            clearTimeout(timer);
            signal.removeEventListener("abort", over);
            on();
        };
        const timer = setTimeout(over, milliseconds);
        signal.addEventListener("abort", over);
    });
}
