// Numbers of frames. A robot may number its frames by their stamps in nanoseconds, and a number of JavaScript is exact
// up to 2^53 only: they stay text, from what the server says to what it is asked for.

/** A frame's number within its session, in digits without leading zeros. */
export type Sequence = string;

/** The largest one that the server takes. */
const LAST = 2n ** 63n - 1n;

/** Reads a number that a person may have written; nothing where it cannot be a frame's. */
export function sequenceOf(written: string | null): Sequence | null {
    if (written === null || !/^\d{1,19}$/.test(written)) return null;
    const number = BigInt(written);
    return number <= LAST ? String(number) : null;
}

/** Below 0 if one frame came before the other, above if after; of two in digits the longer is the larger. */
export function compare(one: Sequence, other: Sequence): number {
    return one.length - other.length || (one < other ? -1 : one > other ? 1 : 0);
}

/** Most digits that have room below a picture, and the last ones, by which frames of one drive differ, of more. */
const [MOST_DIGITS, LAST_DIGITS] = [12, 10];

/** A number where there is little room. */
export function brief(number: Sequence): string {
    return number.length > MOST_DIGITS ? `…${number.slice(-LAST_DIGITS)}` : number;
}

type Named = "sequence" | `${string}_sequence`;

/** A message as it is read here: its numbers of frames are text. */
export type Exact<T> = T extends readonly (infer One)[] ? Exact<One>[]
    : T extends object ? { [Key in keyof T]: Key extends Named ? (T[Key] extends number ? Sequence : Sequence | Exclude<T[Key], number>) : Exact<T[Key]> }
    : T;

/** Reads JSON of the server, in which numbers of frames are numbers. Within a text this does not match: its quotes are escaped. */
export function parse<T>(json: string): T {
    return JSON.parse(json.replace(/"((?:\w+_)?sequence)":(\d+)/g, '"$1":"$2"')) as T;
}
