// A session along its frames: probabilities as lines, the posterior as a heat map, thumbnails around the cursor.
import { useEffect, useMemo, useRef } from "preact/hooks";
import uPlot from "uplot";
import { ink } from "../drawing/colours";
import { at, short, type Session } from "../rest";
import { brief } from "../sequence";
import { count, NoPicture, Picture, plural, Refused, useDark, useSize } from "../parts";
import { DeleteSession } from "./deleting";
import { REASONS, type Step } from "./steps";

interface TimeProps {
    sessions: Session[];
    session: Session;
    steps: Step[];
    whole: boolean;
    more: [before: boolean, after: boolean];
    error: Error | null;
    cursor: number;
    threshold: number | null;
    /** Whether the map keeps any of its frames. */
    pictures: boolean;
    onSession: (name: string) => void;
    onCursor: (index: number | "first" | "last") => void;
    onDeleted: () => void;
}

export function Time(props: TimeProps) {
    const { sessions, session, steps, whole, more, error, cursor, threshold, pictures, onSession, onCursor, onDeleted } = props;
    const step = steps[cursor];
    const [first, last] = [cursor <= 0 && !more[0], cursor >= steps.length - 1 && !more[1]];
    return (
        <section class="panel time" aria-label="Time">
            <header>
                <h2>Time</h2>
                <label>Session{" "}
                    <select value={session.name} onChange={(event) => onSession(event.currentTarget.value)}>
                        {sessions.map(({ name }) => <option key={name} value={name}>{short(name)}</option>)}
                    </select>
                </label>
                <span class="steps">
                    <button type="button" aria-label="First frame" disabled={first} onClick={() => onCursor("first")}>|◀</button>
                    <button type="button" aria-label="Frame before" disabled={first} onClick={() => onCursor(cursor - 1)}>◀</button>
                    <button type="button" aria-label="Next frame" disabled={last} onClick={() => onCursor(cursor + 1)}>▶</button>
                    <button type="button" aria-label="Last frame" disabled={last} onClick={() => onCursor("last")}>▶|</button>
                </span>
                <output data-testid="cursor">{step ? `frame ${step.sequence}: ${REASONS[step.reason] ?? step.reason}` : "no frame"}</output>
                <span class="quiet">{more[0] || more[1] ? `frames ${count(BigInt(steps[0]!.sequence))} to ${count(BigInt(steps.at(-1)!.sequence))}, of ${count(session.frames)}` : plural(steps.length, "frame")}{whole ? "" : ", more are coming"} · keys ← →</span>
            </header>
            {error && <Refused error={error} />}
            {steps.length > 0 && <>
                <Plot steps={steps} cursor={cursor} threshold={threshold} onCursor={onCursor} />
                <Heat steps={steps} cursor={cursor} onCursor={onCursor} />
                <Strip session={session.name} pictures={pictures} steps={steps} cursor={cursor} onCursor={onCursor} />
            </>}
            <p class="actions apart"><DeleteSession key={session.name} session={session} onDeleted={onDeleted} /></p>
        </section>
    );
}

interface AlongProps {
    steps: Step[];
    cursor: number;
    onCursor: (index: number) => void;
}

/** Left of the plot, so that the heat map begins where the lines do. */
const AXIS_PX = 46;
const PLOT_PX = 120;
/** A digit of a frame's number below the plot; half of a short number, and how far the middles of two are apart at least. */
const DIGIT_PX = 7;
const NUMBER_PX = 14;
const NUMBERS_APART_PX = 50;

function Plot({ steps, cursor, threshold, onCursor }: AlongProps & { threshold: number | null }) {
    const [box, { width }] = useSize<HTMLDivElement>();
    const plot = useRef<uPlot | null>(null);
    const dark = useDark();
    const now = useRef({ cursor, onCursor });
    now.current = { cursor, onCursor };
    const data = useMemo((): uPlot.AlignedData => [
        steps.map((_, index) => index),
        steps.map((step) => step.newPlace),
        steps.map((step) => step.posterior),
        steps.map((step) => step.probability),
        steps.map(() => threshold),
    ], [steps, threshold]);
    useEffect(() => {
        if (!box.current || !width) return;
        const { faint, line, accent, closure } = ink(box.current);
        const axis = { stroke: faint, grid: { stroke: line, width: 1 }, ticks: { show: false }, font: "11px system-ui" };
        // A line through one frame is none: its point must show.
        // A number at the very end would be cut off.
        const number_px = DIGIT_PX * (steps.at(-1)?.sequence.length ?? 0);
        const cut = (index: number) => ((index + 0.5) / steps.length) * (width - AXIS_PX) > width - AXIS_PX - Math.max(NUMBER_PX, number_px / 2);
        const [none, few] = [{ show: false }, { show: steps.length === 1 }];
        const made = new uPlot({
            width, height: PLOT_PX,
            padding: [6, 0, 0, 0],
            legend: { show: false },
            cursor: { drag: { x: false, y: false }, y: false },
            scales: { x: { time: false, range: [-0.5, Math.max(steps.length - 0.5, 0.5)] }, y: { range: [0, 1.05] } },
            axes: [
                { ...axis, size: 22, space: Math.max(NUMBERS_APART_PX, number_px + DIGIT_PX), values: (_, at) => at.map((index) => Number.isInteger(index) && !cut(index) ? String(steps[index]?.sequence ?? "") : "") },
                { ...axis, size: AXIS_PX, values: (_, at) => at.map((value) => value.toFixed(1)) },
            ],
            series: [
                {},
                { label: "new", stroke: faint, width: 1.5, dash: [5, 3], points: none },
                { label: "match", stroke: accent, width: 1.5, points: few },
                { label: "views", stroke: closure, width: 0, points: { show: true, size: 6, fill: closure } },
                { label: "threshold", stroke: closure, width: 1, dash: [2, 3], points: none },
            ],
            hooks: {
                draw: [(drawn) => {
                    const x = drawn.valToPos(now.current.cursor, "x", true);
                    drawn.ctx.save();
                    drawn.ctx.fillStyle = accent;
                    drawn.ctx.fillRect(x - 1, drawn.bbox.top, 2, drawn.bbox.height);
                    drawn.ctx.restore();
                }],
                ready: [(drawn) => drawn.over.addEventListener("click", () => {
                    if (drawn.cursor.idx !== null && drawn.cursor.idx !== undefined) now.current.onCursor(drawn.cursor.idx);
                })],
            },
        }, data, box.current);
        plot.current = made;
        return () => {
            plot.current = null;
            made.destroy();
        };
    }, [width, data, dark]);
    useEffect(() => plot.current?.redraw(false), [cursor]);
    return <>
        <div class="plot" ref={box} role="img" aria-label={describeAt(steps[cursor], threshold)} />
        <p class="legend" aria-hidden="true">
            <span class="key new">somewhere new</span><span class="key match">the most probable place, by words</span>
            <span class="key views">the closure, by words and geometry</span><span class="key threshold">threshold</span>
        </p>
    </>;
}

function describeAt(step: Step | undefined, threshold: number | null): string {
    if (!step) return "Probabilities along the session";
    const views = step.probability === null ? "" : `, of the closure ${step.probability.toFixed(3)}`;
    return `At frame ${step.sequence}: probability of somewhere new ${step.newPlace.toFixed(3)}, of the most probable place ` +
        `${step.posterior.toFixed(3)}${views}; threshold ${threshold ?? "unknown"}`;
}

const HEAT_PX = 96;
/** A decided place, and that of the cursor's frame. */
const MARK_PX = 4;
const CURSOR_MARK_PX = 6;

/** Time by place: the ten most probable places of each frame, the decided one marked. */
function Heat({ steps, cursor, onCursor }: AlongProps) {
    const [box, { width }] = useSize<HTMLDivElement>();
    const canvas = useRef<HTMLCanvasElement>(null);
    const dark = useDark();
    useEffect(() => {
        const context = canvas.current?.getContext("2d");
        if (!canvas.current || !context || width <= AXIS_PX) return;
        const sharp = devicePixelRatio || 1;
        canvas.current.width = width * sharp;
        canvas.current.height = HEAT_PX * sharp;
        context.setTransform(sharp, 0, 0, sharp, 0, 0);
        heat(context, steps, cursor, width, ink(canvas.current));
    }, [steps, cursor, width, dark]);
    return <>
        <div class="heat" ref={box}>
            <canvas
                ref={canvas} role="img" aria-label="Posterior over places, frame by frame"
                onClick={(event) => {
                    const along = (event.offsetX - AXIS_PX) / (width - AXIS_PX);
                    onCursor(Math.min(Math.max(Math.floor(along * steps.length), 0), steps.length - 1));
                }}
            />
        </div>
        <p class="legend" aria-hidden="true">
            <span>probability of each place: 0 <span class="ramp posterior" /> 1</span><span class="key decided">the place that was decided</span>
        </p>
    </>;
}

function heat(context: CanvasRenderingContext2D, steps: Step[], cursor: number, width: number, colours: ReturnType<typeof ink>) {
    const most = steps.reduce((most, { place, likely }) => Math.max(most, place ?? 0, ...likely.map(([place]) => place)), 0);
    const [cell, row] = [(width - AXIS_PX) / steps.length, HEAT_PX / (most + 1)];
    const x = (index: number) => AXIS_PX + index * cell;
    const y = (place: number) => HEAT_PX - (place + 1) * row;
    context.clearRect(0, 0, width, HEAT_PX);
    context.fillStyle = colours.line;
    context.globalAlpha = 0.35;
    context.fillRect(AXIS_PX, 0, width - AXIS_PX, HEAT_PX);
    context.globalAlpha = 1;
    const [wide, tall] = [Math.max(cell, 1.5), Math.max(row, 1.5)];
    context.fillStyle = colours.heat;
    steps.forEach(({ likely }, index) => {
        for (const [place, posterior] of likely) {
            if (posterior < 0.001) continue;
            context.globalAlpha = Math.sqrt(posterior);
            context.fillRect(x(index), y(place), wide, tall);
        }
    });
    context.globalAlpha = 1;
    context.fillStyle = colours.accent;
    context.fillRect(x(cursor) + cell / 2 - 1, 0, 2, HEAT_PX);
    context.fillStyle = colours.closure;
    steps.forEach(({ place }, index) => {
        if (place === null) return;
        const size = index === cursor ? CURSOR_MARK_PX : MARK_PX;
        const within = (wanted: number, least: number, most: number) => Math.min(Math.max(wanted, least), most - size);
        context.fillRect(within(x(index) + (cell - size) / 2, AXIS_PX, width), within(y(place) + (row - size) / 2, 0, HEAT_PX), size, size);
    });
    context.fillStyle = colours.faint;
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "right";
    context.textBaseline = "top";
    if (most > 0) context.fillText(String(most), AXIS_PX - 6, 1);
    context.textBaseline = "bottom";
    context.fillText("place 0", AXIS_PX - 6, HEAT_PX - 1);
}

const THUMBNAIL_PX = 92;

/** The frames around the cursor; the rest is not asked for. */
function Strip({ session, pictures, steps, cursor, onCursor }: AlongProps & Pick<TimeProps, "pictures"> & { session: string }) {
    const [box, { width }] = useSize<HTMLDivElement>();
    const fitting = Math.max(Math.floor(width / THUMBNAIL_PX), 1);
    const first = Math.max(Math.min(cursor - Math.floor(fitting / 2), steps.length - fitting), 0);
    const shown = width ? steps.slice(first, first + fitting) : [];
    return (
        <div class="strip" ref={box} role="group" aria-label="Frames around the cursor">
            {shown.map((step, offset) => {
                const index = first + offset;
                const words = `Frame ${step.sequence}: ${REASONS[step.reason] ?? step.reason}${step.note && `, ${step.note}`}`;
                return (
                    <button
                        key={step.sequence} type="button" class={`frame ${step.reason}`} aria-current={index === cursor}
                        aria-label={words} title={words} onClick={() => onCursor(index)}
                    >
                        {pictures ? <Picture path={`${at(session)}/frames/${step.sequence}/image?size=thumbnail`} alt="" /> : <NoPicture />}
                        <span>{brief(step.sequence)}</span>
                    </button>
                );
            })}
        </div>
    );
}
