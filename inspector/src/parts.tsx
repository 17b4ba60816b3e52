// Small parts that every panel uses: what is loading, what was refused, pictures, numbers.
import { createContext, type ComponentChildren } from "preact";
import { useContext, useEffect, useRef, useState } from "preact/hooks";
import { at, blob, get, Refusal, type Caller, type Job, type WayMap } from "./rest";

/** Who the server says that this page is; nobody until it has. */
export const Who = createContext<Caller | null>(null);

/** Whether the person may do what is for administrators. */
export function useMayAll(): boolean {
    return useContext(Who)?.role === "admin";
}

/** Whether the person may do one of the things that a token may be good for. */
export function useMay(ability: Caller["abilities"][number]): boolean {
    return useContext(Who)?.abilities.includes(ability) ?? false;
}

/**
 * How many times what is below was found to be of another map, or of one with other numbers: what was asked for by numbers of
 * places is asked for anew, and pictures are.
 */
export const Renewals = createContext(0);

/** What is being asked for: nothing yet but what came before, an answer, or why there is none. */
export type Asked<T> = { state: "asking"; before?: T } | { state: "there"; value: T } | { state: "refused"; error: Error };

/** A server that does not answer is asked again so soon. */
const AWAY_MS = 3000;

/** Whether the server was not reached: what it would say is not known. */
function isAway(error: Error): boolean {
    return error instanceof Refusal && error.status === 0;
}

/** Asks again whenever `about` changes or the map was renewed, and while the server does not answer; answers that come too late are thrown away. */
export function useAsked<T>(ask: (signal: AbortSignal) => Promise<T>, about: readonly unknown[]): Asked<T> {
    const [asked, setAsked] = useState<Asked<T>>({ state: "asking" });
    const renewals = useContext(Renewals);
    useEffect(() => {
        const gone = new AbortController();
        let timer = 0;
        setAsked((last) => last.state === "there" ? { state: "asking", before: last.value } : { state: "asking" });
        const look = () => ask(gone.signal).then(
            (value) => gone.signal.aborted || setAsked({ state: "there", value }),
            (error: Error) => {
                if (gone.signal.aborted) return;
                setAsked({ state: "refused", error });
                if (isAway(error)) timer = window.setTimeout(look, AWAY_MS);
            },
        );
        void look();
        return () => {
            gone.abort();
            clearTimeout(timer);
        };
    }, [...about, renewals]);
    return asked;
}

export interface Polled<T> {
    value: T | null;
    error: Error | null;
    again: () => void;
}

/** What was refused is asked for again no sooner than this: each refusal is kept by the server. */
const REFUSED_MS = 15_000;

/** Asks again and again while the page is looked at, after a pause that the last answer decides; `null` is for good. */
export function usePolled<T>(ask: (signal: AbortSignal) => Promise<T>, pauseMs: (value: T | null) => number | null, about: readonly unknown[] = []): Polled<T> {
    const [known, setKnown] = useState<Omit<Polled<T>, "again">>({ value: null, error: null });
    const [times, setTimes] = useState(0);
    useEffect(() => {
        const gone = new AbortController();
        let timer = 0;
        let value: T | null = null;
        const poll = async () => {
            try {
                if (document.visibilityState === "visible") {
                    value = await ask(gone.signal);
                    if (!gone.signal.aborted) setKnown({ value, error: null });
                }
            } catch (error) {
                if (!gone.signal.aborted) setKnown((now) => ({ ...now, error: error as Error }));
                if (!gone.signal.aborted && !isAway(error as Error)) return void (timer = window.setTimeout(poll, REFUSED_MS));
            }
            const pause = pauseMs(value);
            if (!gone.signal.aborted && pause !== null) timer = window.setTimeout(poll, pause);
        };
        void poll();
        return () => {
            gone.abort();
            clearTimeout(timer);
        };
    }, [times, ...about]);
    return { ...known, again: () => setTimes((times) => times + 1) };
}

interface ShownProps<T> {
    asked: Asked<T>;
    what: string;
    children: (value: T) => ComponentChildren;
}

export function Shown<T>({ asked, what, children }: ShownProps<T>) {
    switch (asked.state) {
        case "asking":
            // A cursor that moves on shows what was there, dimmed: panels that collapse and grow again would jump.
            return asked.before === undefined
                ? <p class="quiet" role="status">Loading {what}…</p>
                : <div class="stale" aria-busy="true" inert>{children(asked.before)}</div>;
        case "refused":
            return <Refused error={asked.error} />;
        case "there":
            return <>{children(asked.value)}</>;
    }
}

/** Work that a person began by hand: whether it goes on, and what became of it. */
export type Told = { state: "idle" } | { state: "busy"; doing: string } | { state: "done"; what: string } | { state: "refused"; error: Error };

/** Does one thing at a time, and says how it goes. */
export function useAttempt() {
    const [told, setTold] = useState<Told>({ state: "idle" });
    const attempt = async (doing: string, act: (tell: (doing: string) => void) => Promise<string>) => {
        const tell = (doing: string) => setTold({ state: "busy", doing });
        tell(doing);
        try {
            setTold({ state: "done", what: await act(tell) });
            return true;
        } catch (error) {
            setTold({ state: "refused", error: error as Error });
            return false;
        }
    };
    return { told, busy: told.state === "busy", attempt };
}

/** How an attempt goes, for everybody. */
export function Outcome({ told }: { told: Told }) {
    if (told.state === "refused") return <Refused error={told.error} />;
    return <p class="quiet outcome" role="status">{told.state === "busy" ? `${told.doing}…` : told.state === "done" ? told.what : ""}</p>;
}

const JOB_POLL_MS = 500;
/** How long a server is waited for that does not answer: another one may go on with the job. */
const PATIENCE_MS = 60_000;
const AWAY = [0, 502, 503, 504];

/** Until a job has ended; says how far it is. What did not go well is an error. */
export async function ended(begun: Job, tell: (doing: string) => void): Promise<Job> {
    let job = begun;
    let heard = Date.now();
    while (job.state === "running") {
        tell(`${job.stage || "waiting"}, ${Math.round(job.fraction * 100)} %`);
        await new Promise((later) => setTimeout(later, JOB_POLL_MS));
        try {
            job = await get<Job>(at(begun.name));
            heard = Date.now();
        } catch (error) {
            const away = error instanceof Refusal && AWAY.includes(error.status);
            if (!away || Date.now() - heard > PATIENCE_MS) throw error;
        }
    }
    if (job.state !== "succeeded") throw new Error(job.error?.message ?? `The job was ${job.state}.`);
    return job;
}

interface DialogProps {
    title: string;
    onClose: () => void;
    children: ComponentChildren;
}

/** A question that must be answered, or left by Escape, before anything else. */
export function Dialog({ title, onClose, children }: DialogProps) {
    const dialog = useRef<HTMLDialogElement>(null);
    useEffect(() => dialog.current?.showModal(), []);
    return (
        <dialog class="question" ref={dialog} aria-label={title} onClose={onClose}>
            <header>
                <h2>{title}</h2>
                <button type="button" aria-label="Close" onClick={() => dialog.current?.close()}>✕</button>
            </header>
            {children}
        </dialog>
    );
}

interface QuestionProps {
    title: string;
    /** What follows from it. */
    loss: string;
    /** What has to be typed where it cannot be taken back; nothing else needs a name. */
    name?: string;
    verb: string;
    doing: string;
    act: (tell: (doing: string) => void) => Promise<unknown>;
    onDone: () => void;
    onClose: () => void;
}

/** Asks before something is done. What cannot be taken back is done by who types its name: not by a slip of the hand. */
export function Question({ title, loss, name, verb, doing, act, onDone, onClose }: QuestionProps) {
    const [typed, setTyped] = useState("");
    const { told, busy, attempt } = useAttempt();
    const go = async () => {
        if (await attempt(doing, async (tell) => {
            await act(tell);
            return "done";
        })) onDone();
    };
    return (
        <Dialog title={title} onClose={onClose}>
            <form onSubmit={(event) => {
                event.preventDefault();
                void go();
            }}>
                <p>{loss}</p>
                {name !== undefined && <label><span>Type <strong>{name}</strong> to go on</span> <input value={typed} autoComplete="off" autoFocus spellcheck={false} onInput={(event) => setTyped(event.currentTarget.value)} /></label>}
                <p class="actions"><button type="submit" class={name === undefined ? "main" : "stop"} disabled={busy || typed !== (name ?? "")}>{verb}</button></p>
                <Outcome told={told} />
            </form>
        </Dialog>
    );
}

type DeletionProps = Pick<QuestionProps, "loss" | "act" | "onDone" | "onClose"> & {
    /** What it is, as in "the map". */
    what: string;
    /** What has to be typed. */
    name: string;
};

/** Deletes what a person has named. */
export function Deletion({ what, name, ...rest }: DeletionProps) {
    return <Question title={`Delete ${what} ${name}?`} name={name} verb={`Delete ${what}`} doing="Deleting" {...rest} />;
}

export function Refused({ error }: { error: Error }) {
    return <p class="refused" role="alert">{error.message}</p>;
}

/** Pictures that were loaded lately, so that a cursor that moves back shows them at once. */
const kept = new Map<string, Promise<string>>();
const MOST_KEPT = 400;

function loaded(path: string): Promise<string> {
    const known = kept.get(path);
    if (known) return known;
    const coming = blob(path).then((bytes) => URL.createObjectURL(bytes));
    coming.catch(() => kept.delete(path));
    kept.set(path, coming);
    for (const [oldest, url] of kept) {
        if (kept.size <= MOST_KEPT) break;
        kept.delete(oldest);
        url.then(URL.revokeObjectURL, () => {});
    }
    return coming;
}

/** Forgets all pictures: another token may see others, and a map that was renewed has others. */
export function forgetPictures() {
    for (const url of kept.values()) url.then(URL.revokeObjectURL, () => {});
    kept.clear();
}

interface PictureProps {
    path: string;
    alt: string;
    class?: string;
}

/** A picture of REST. It is fetched, because a plain `img` would send no token. */
export function Picture({ path, alt, class: kind = "" }: PictureProps) {
    const [url, setUrl] = useState<string | null>(null);
    const [missing, setMissing] = useState<string | null>(null);
    const renewals = useContext(Renewals);
    useEffect(() => {
        let gone = false;
        let timer = 0;
        setMissing(null);
        setUrl(null);
        const look = () => void loaded(path).then(
            (url) => gone || setUrl(url),
            (error: Error) => {
                if (gone) return;
                if (isAway(error)) timer = window.setTimeout(look, AWAY_MS);
                else setMissing(error.message);
            },
        );
        look();
        return () => {
            gone = true;
            clearTimeout(timer);
        };
    }, [path, renewals]);
    // Beside a text that says the same, a picture is nothing to those who hear the page.
    const heard = alt ? { role: "img" as const, "aria-label": alt } : { "aria-hidden": true };
    // What it says is of the style: buttons around it are called otherwise.
    if (missing) return <div class={`picture missing ${kind}`} title={missing} {...heard} />;
    if (!url) return <div class={`picture ${kind}`} {...heard} />;
    return <img class={`picture ${kind}`} src={url} alt={alt} />;
}

/** Whether a map keeps anything to be seen of its frames: the server would refuse each picture by itself. */
export function keepsPictures({ settings }: WayMap): boolean {
    return settings?.keep !== "words";
}

/** Where there is none, and it is known why. */
export function NoPicture({ why = "This map keeps words alone" }: { why?: string }) {
    return <div class="picture missing" title={why} aria-hidden="true" />;
}

/** The size of an element on the screen, as it changes. */
export function useSize<E extends HTMLElement>() {
    const element = useRef<E>(null);
    const [size, setSize] = useState({ width: 0, height: 0 });
    useEffect(() => {
        if (!element.current) return;
        const watch = new ResizeObserver(([entry]) => {
            const { width = 0, height = 0 } = entry?.contentRect ?? {};
            setSize({ width: Math.floor(width), height: Math.floor(height) });
        });
        watch.observe(element.current);
        return () => watch.disconnect();
    }, []);
    return [element, size] as const;
}

export function count(value: number | bigint): string {
    return value.toLocaleString("en-GB");
}

export function plural(value: number, one: string, more = `${one}s`): string {
    return `${count(value)} ${value === 1 ? one : more}`;
}

export function bytes(value: number): string {
    const units = ["B", "kB", "MB", "GB", "TB"];
    let unit = 0;
    for (; value >= 999.5 && unit < units.length - 1; unit++) value /= 1000;
    return `${unit && value < 10 ? value.toFixed(1) : Math.round(value)} ${units[unit]}`;
}

/** So many decimals, without a minus before a zero. */
export function fixed(value: number, digits: number): string {
    const steps = 10 ** digits;
    return (Math.round(value * steps) / steps + 0).toFixed(digits);
}

export function share(value: number): string {
    if (value > 0 && value < 0.0005) return "< 0.001";
    if (value < 1 && value > 0.9995) return "> 0.999";
    return value.toFixed(3);
}

/** A time where the person is, with the zone: the server's log is in UTC. */
export function moment(time_ns: number): string {
    // Swedes write dates as ISO 8601 does.
    return new Date(time_ns / 1e6).toLocaleString("sv-SE", {
        year: "numeric", month: "2-digit", day: "2-digit", hour: "2-digit", minute: "2-digit", second: "2-digit", timeZoneName: "short",
    });
}

/** Some milliseconds, for a cursor that may move on: what is left behind is never asked for. */
export function pause(milliseconds: number, signal: AbortSignal): Promise<void> {
    return new Promise((on, off) => {
        const timer = setTimeout(on, milliseconds);
        signal.addEventListener("abort", () => {
            clearTimeout(timer);
            off(new DOMException("the cursor moved on", "AbortError"));
        });
    });
}

/** Gives the page another look when the person asks for dark or light. */
export function useDark(): boolean {
    return useMedia("(prefers-color-scheme: dark)");
}

/** Whether all is in one column, as in the style. */
export function useNarrow(): boolean {
    return useMedia("(max-width: 960px)");
}

function useMedia(query: string): boolean {
    const [matches, setMatches] = useState(() => matchMedia(query).matches);
    useEffect(() => {
        const watched = matchMedia(query);
        const changed = () => setMatches(watched.matches);
        watched.addEventListener("change", changed);
        return () => watched.removeEventListener("change", changed);
    }, []);
    return matches;
}
