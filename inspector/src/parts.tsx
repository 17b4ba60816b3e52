// Small parts that every panel uses: what is loading, what was refused, pictures, numbers.
import type { ComponentChildren } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { blob } from "./rest";

/** What is being asked for: nothing yet but what came before, an answer, or why there is none. */
export type Asked<T> = { state: "asking"; before?: T } | { state: "there"; value: T } | { state: "refused"; error: Error };

/** Asks again whenever `about` changes; answers that come too late are thrown away. */
export function useAsked<T>(ask: (signal: AbortSignal) => Promise<T>, about: readonly unknown[]): Asked<T> {
    const [asked, setAsked] = useState<Asked<T>>({ state: "asking" });
    useEffect(() => {
        const gone = new AbortController();
        setAsked((last) => last.state === "there" ? { state: "asking", before: last.value } : { state: "asking" });
        ask(gone.signal).then(
            (value) => gone.signal.aborted || setAsked({ state: "there", value }),
            (error: Error) => gone.signal.aborted || setAsked({ state: "refused", error }),
        );
        return () => gone.abort();
    }, about);
    return asked;
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

/** Forgets all pictures: another token may see others. */
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
    useEffect(() => {
        let gone = false;
        setMissing(null);
        setUrl(null);
        loaded(path).then(
            (url) => gone || setUrl(url),
            (error: Error) => gone || setMissing(error.message),
        );
        return () => {
            gone = true;
        };
    }, [path]);
    if (missing) return <div class={`picture missing ${kind}`} title={missing} role="img" aria-label={alt}>no image</div>;
    if (!url) return <div class={`picture ${kind}`} role="img" aria-label={alt} />;
    return <img class={`picture ${kind}`} src={url} alt={alt} />;
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

export function count(value: number): string {
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

export function share(value: number): string {
    if (value > 0 && value < 0.0005) return "< 0.001";
    if (value < 1 && value > 0.9995) return "> 0.999";
    return value.toFixed(3);
}

export function moment(time_ns: number): string {
    return new Date(time_ns / 1e6).toISOString().replace("T", " ").slice(0, 19);
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
    const query = "(prefers-color-scheme: dark)";
    const [dark, setDark] = useState(() => matchMedia(query).matches);
    useEffect(() => {
        const watched = matchMedia(query);
        const changed = () => setDark(watched.matches);
        watched.addEventListener("change", changed);
        return () => watched.removeEventListener("change", changed);
    }, []);
    return dark;
}
