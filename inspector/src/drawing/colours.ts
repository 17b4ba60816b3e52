// Colours that people who see few of them can tell apart: Okabe and Ito's for what has a name, viridis for amounts.

export const NAMED = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a8d00", "#7a5bc7"] as const;

const VIRIDIS: readonly (readonly [number, number, number])[] = [
    [68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99],
    [170, 220, 50], [253, 231, 37],
];

export function named(number: number): string {
    return NAMED[number % NAMED.length]!;
}

/** Viridis from 0 to 1. */
export function viridis(amount: number): [number, number, number] {
    const along = Math.min(Math.max(amount, 0), 1) * (VIRIDIS.length - 1);
    const before = Math.min(Math.floor(along), VIRIDIS.length - 2);
    const [from, to] = [VIRIDIS[before]!, VIRIDIS[before + 1]!];
    const mixed = (channel: 0 | 1 | 2) => Math.round(from[channel] + (to[channel] - from[channel]) * (along - before));
    return [mixed(0), mixed(1), mixed(2)];
}

export function css([red, green, blue]: [number, number, number]): string {
    return `rgb(${red} ${green} ${blue})`;
}

/** In how many steps amounts are drawn: one path a step is quicker than one a place. */
export const STEPS = 16;

export function step(amount: number): number {
    return Math.min(Math.floor(Math.min(Math.max(amount, 0), 1) * STEPS), STEPS - 1);
}

/** The steps of viridis that stand out: its dark end is lost on a dark page, its light end on a light one. */
function ramp([from, to]: [number, number]): string[] {
    return Array.from({ length: STEPS }, (_, at) => css(viridis(from + ((to - from) * at) / (STEPS - 1))));
}

const ON_DARK = ramp([0.28, 1]);
const ON_LIGHT = ramp([0, 0.9]);
const WORSE_ON_LIGHT = [...ON_LIGHT].reverse();

/** Colours of the page for the canvas, which does not know its style. */
export function ink(element: Element) {
    const style = getComputedStyle(element);
    const of = (name: string) => style.getPropertyValue(name).trim();
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    return {
        ramp: dark ? ON_DARK : ON_LIGHT,
        // What is worst stands out most from the page.
        worse: dark ? ON_DARK : WORSE_ON_LIGHT,
        text: of("--text"), faint: of("--faint"), line: of("--line"), back: of("--back"), accent: of("--accent"),
        closure: of("--closure"), link: of("--link"), odometry: of("--odometry"), heat: of("--heat"),
    };
}

export type Ink = ReturnType<typeof ink>;
