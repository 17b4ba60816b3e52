// What the server's own metrics said over the last hour: what it has kept itself, and since then what the page has asked.
import { useEffect, useState } from "preact/hooks";
import { get, text, type Schemas } from "../rest";

const EVERY_MS = 5000;
const HOUR_S = 3600;

/** What the server said at a moment; sums of a metric over all its labels, but for those that are asked for. */
export interface Sample {
    /** Seconds since 1970. */
    at: number;
    values: Map<string, number>;
}

interface Hour {
    samples: Sample[];
    /** What the server has refused, as it said first and last. */
    refused: { first: Refusals; now: Refusals } | null;
    error: Error | null;
}

/** The server's newest word of a metric, over all its labels; `null` while there is none, 0 if it says nothing of it. */
export function newestOf(name: string): number | null {
    const newest = hour.samples.at(-1);
    return newest ? (newest.values.get(name) ?? 0) : null;
}

/** Labels that tell things apart that do not add up. */
const APART = /\b(stage|outcome)="([^"]*)"/;

/** Reads Prometheus' text format as far as this server writes it. */
export function parsed(text: string): Map<string, number> {
    const values = new Map<string, number>();
    for (const line of text.split("\n")) {
        const [, name, labels = "", written] = /^([a-z_]+)(?:\{(.*)\})? (\S+)$/.exec(line) ?? [];
        const value = Number(written);
        if (!name || name.endsWith("_bucket") || !Number.isFinite(value)) continue;
        const apart = APART.exec(labels)?.[2];
        for (const key of apart === undefined ? [name] : [name, `${name} ${apart}`]) values.set(key, (values.get(key) ?? 0) + value);
    }
    return values;
}

/** How often the server refused something, by what it was and why. */
export type Refusals = Map<string, { what: string; why: string; times: number }>;

/** What became of a frame that was taken. */
const TAKEN = ["new_place", "same_place", "loop_closure", "below_threshold", "too_few_words", "geometry_refused", "resent"];
/** Calls that went well, or that the caller itself gave up. */
const WELL = ["ok", "cancelled"];

/** What was refused, as far as the metrics tell it: nobody's name is in them. */
export function refusalsIn(text: string): Refusals {
    const found: Refusals = new Map();
    for (const line of text.split("\n")) {
        const [, name, labels = "", written] = /^(waypost_[a-z_]+_total)\{(.*)\} (\S+)$/.exec(line) ?? [];
        const label = Object.fromEntries([...labels.matchAll(/([a-z_]+)="((?:[^"\\]|\\.)*)"/g)].map(([, key, value]) => [key!, value!]));
        const refusal = refusalOf(name, label);
        const times = Number(written);
        if (refusal && times > 0) found.set(JSON.stringify(refusal), { what: refusal[0], why: refusal[1], times });
    }
    return found;
}

function refusalOf(name: string | undefined, label: Record<string, string>): [what: string, why: string] | null {
    const { outcome = "", code = "", method = "", route = "", quota = "", of = "" } = label;
    switch (name) {
        case "waypost_frames_total":
            return TAKEN.includes(outcome) ? null : ["a frame", outcome.replaceAll("_", " ")];
        case "waypost_quota_refusals_total":
            return [`beyond a quota of ${of === "token" ? "a token" : "the server"}`, quota];
        case "waypost_http_requests_total":
            return Number(code) < 400 ? null : [`REST ${method} ${route}`, code];
        case "waypost_grpc_requests_total":
            return WELL.includes(code.toLowerCase()) ? null : [`gRPC ${method}`, code.replaceAll("_", " ")];
        default:
            return null;
    }
}

let hour: Hour = { samples: [], refused: null, error: null };
/** Who draws it: only those panels are to be drawn anew every few seconds. */
const drawers = new Set<(hour: Hour) => void>();

function setHour(next: Hour) {
    hour = next;
    for (const draw of drawers) draw(hour);
}

/** What the server has kept of the hour before this page. */
async function before(signal: AbortSignal): Promise<Sample[]> {
    const { times_ns, series } = await get<Schemas["MetricsHistory"]>("/v1/metrics-history", signal);
    const named = series.map(({ metric, part, values }) => [part ? `${metric} ${part}` : metric, values] as const);
    // By this page's clock, should the server's be ahead.
    const ahead = Math.max((times_ns.at(-1) ?? 0) / 1e9 - Date.now() / 1000, 0);
    return times_ns.map((at_ns, index) => ({
        at: at_ns / 1e9 - ahead, values: new Map(named.map(([name, values]) => [name, values[index] ?? 0])),
    }));
}

/** Asks for the metrics again and again while the page is there, whatever it shows. */
export function useSampling(entered: number, waits: boolean) {
    useEffect(() => {
        if (waits) return;
        const gone = new AbortController();
        let timer = 0;
        const ask = async () => {
            try {
                if (hour.samples.length === 0) setHour({ ...hour, samples: await before(gone.signal) });
                const said = await text("/metrics", gone.signal);
                const [values, now] = [parsed(said), refusalsIn(said)];
                const at = Date.now() / 1000;
                const samples = [...hour.samples.filter((sample) => sample.at > at - HOUR_S), { at, values }];
                setHour({ samples, refused: { first: hour.refused?.first ?? now, now }, error: null });
            } catch (error) {
                if (!gone.signal.aborted) setHour({ ...hour, error: error as Error });
            }
            if (!gone.signal.aborted) timer = window.setTimeout(ask, EVERY_MS);
        };
        void ask();
        return () => {
            gone.abort();
            clearTimeout(timer);
        };
    }, [entered, waits]);
}

export function useHour(): Hour {
    const [now, setNow] = useState(hour);
    useEffect(() => {
        drawers.add(setNow);
        setNow(hour);
        return () => {
            drawers.delete(setNow);
        };
    }, []);
    return now;
}
