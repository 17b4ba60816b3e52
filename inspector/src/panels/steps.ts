// The frames of a session: as they were, page by page, and as they come.
import { useEffect, useRef, useState } from "preact/hooks";
import { at, pages, short, type FrameRecord, type Session } from "../rest";
import { compare, type Sequence } from "../sequence";
import { sessionOf } from "./live";

/** What the strip needs of a frame: sessions are long. */
export interface Step {
    sequence: Sequence;
    /** What its robot calls it, as by the name of its file; empty if nothing. */
    note: string;
    stamp_ns: number;
    /** Of the decision, or that a person withdrew it. */
    reason: string;
    place: number | null;
    /** Of the place that was the most probable one, by words. */
    posterior: number;
    newPlace: number;
    probability: number | null;
    likely: [place: number, posterior: number][];
}

function stepOf({ name, note, stamp_ns, answer, corrections }: FrameRecord): Step {
    return {
        sequence: short(name),
        note,
        stamp_ns,
        reason: corrections.some(({ verdict }) => verdict === "withdrawn") ? "withdrawn" : (answer?.reason ?? "unknown"),
        place: answer?.place_number ?? null,
        posterior: answer?.places[0]?.posterior ?? 0,
        newPlace: answer?.new_place_posterior ?? 0,
        probability: answer?.match?.geometry?.probability ?? null,
        likely: answer?.places.map(({ place_number, posterior }) => [place_number, posterior]) ?? [],
    };
}

export const REASONS: Record<string, string> = {
    new_place: "new place", same_place: "same place", loop_closure: "loop closure",
    withdrawn: "closure withdrawn", below_threshold: "below the threshold", too_few_words: "too few words", geometry_refused: "geometry refused",
};

export interface Steps {
    steps: Step[];
    /** Whether all that is asked for is here. */
    whole: boolean;
    /** Whether there are more before and after: of long sessions only those around the cursor are here. */
    more: [before: boolean, after: boolean];
    error: Error | null;
}

const NONE: Steps = { steps: [], whole: false, more: [false, false], error: null };

/** Longer sessions are listed in windows, each of which begins in the middle of the one before. */
const LONG = 5000;
const WINDOW = 2000;
const STRIDE = WINDOW / 2;

interface Window {
    from: Sequence;
    /** The window after it has the frames from here on in its middle: what is listed must reach it. */
    until: Sequence;
}

/**
 * The window that has a frame in its middle; none if the session is listed as a whole. Numbers may lie apart, as stamps do:
 * windows are as much longer. That is rounded down to a power of two, so that a session that grows keeps its windows.
 */
export function windowOf(session: Session | null, frame: Sequence | null): Window | null {
    const { first_sequence = null, last_sequence = null, frames } = session ?? { frames: 0 };
    if (first_sequence === null || last_sequence === null || frames <= LONG) return null;
    const [first, last] = [BigInt(first_sequence), BigInt(last_sequence)];
    const apart = (last - first) / BigInt(frames - 1);
    const stride = BigInt(STRIDE) << BigInt(Math.max(apart.toString(2).length - 1, 0));
    const strides = (BigInt(frame ?? first_sequence) - first - stride / 2n) / stride;
    const from = first + (strides > 0n ? strides : 0n) * stride;
    return { from: String(from), until: String(from + stride + stride / 2n) };
}

/** Most frames that are kept of those that come while the page is open for days: the oldest make room. */
const MOST_STEPS = 100_000;

/**
 * The frames of a session, of a long one those around the cursor's, and what adds those that were decided since. They are
 * listed anew with other `times`.
 */
export function useSteps(of: Session | null, frame: Sequence | null, times: number): Steps & { hear: (frames: FrameRecord[]) => void } {
    const session = of?.name ?? null;
    const around = windowOf(of, frame);
    const from = around?.from ?? null;
    const [known, setKnown] = useState<Steps & { of: string | null }>({ of: session, ...NONE });
    const listed = useRef<string | null>(null);
    const coming = useRef<Step[]>([]);
    useEffect(() => {
        const gone = new AbortController();
        // What is listed anew stays until the new list is there.
        const anew = listed.current === session && session !== null;
        listed.current = session;
        coming.current = [];
        if (!anew) setKnown({ of: session, ...NONE, whole: session === null });
        if (session === null) return;
        const read = async () => {
            let steps: Step[] = [];
            let more = false;
            for await (const page of pages<"frames", FrameRecord>(`${at(session)}/frames`, "frames", gone.signal, undefined, from === null ? {} : { from_sequence: from })) {
                steps = steps.concat(page.map(stepOf));
                more = around !== null && steps.length >= WINDOW && compare(steps.at(-1)!.sequence, around.until) >= 0;
                if (more) break;
                if (!gone.signal.aborted && !anew) setKnown({ of: session, ...NONE, steps });
            }
            if (gone.signal.aborted) return;
            const last = of?.last_sequence ?? null;
            const after = more && last !== null && compare(steps.at(-1)?.sequence ?? last, last) < 0;
            const before = from !== null && compare(from, of?.first_sequence ?? from) > 0;
            setKnown({ of: session, steps: after ? steps : grown(steps, coming.current), whole: true, more: [before, after], error: null });
        };
        read().catch((error: Error) => gone.signal.aborted || setKnown((now) => ({ ...now, error })));
        return () => gone.abort();
    }, [session, from, times]);
    const hear = (frames: FrameRecord[]) => {
        const own = frames.filter((frame) => sessionOf(frame) === session).map(stepOf);
        if (own.length === 0) return;
        coming.current = grown(coming.current, own);
        setKnown((now) => now.whole && !now.more[1] ? { ...now, steps: grown(now.steps, own) } : now);
    };
    // Frames of the session before are none of this one's.
    return { ...(known.of === session ? known : NONE), hear };
}

/** With what is newer at the end. */
function grown(steps: Step[], newer: Step[]): Step[] {
    const last = steps.at(-1);
    const added = last ? newer.filter(({ sequence }) => compare(sequence, last.sequence) > 0) : newer;
    if (added.length === 0) return steps;
    const most = Math.max(MOST_STEPS, steps.length);
    return steps.concat(added).slice(-most);
}
