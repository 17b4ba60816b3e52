// How the server fares: its own metrics over the last hour.
import { useEffect, useMemo, useRef } from "preact/hooks";
import uPlot from "uplot";
import { ink } from "../drawing/colours";
import { bytes, Refused, useDark, useSize } from "../parts";
import { useHour, type Sample } from "./hour";

type Line = [label: string, of: (now: Sample, before: Sample) => number | null];

interface Chart {
    title: string;
    lines: Line[];
    show: (value: number) => string;
}

const level = (name: string) => (now: Sample) => now.values.get(name) ?? null;
/** A counter's rise per second. One that fell is a server that began anew. */
const rate = (...names: string[]) => (now: Sample, before: Sample) => {
    const rise = names.reduce((sum, name) => sum + (now.values.get(name) ?? 0) - (before.values.get(name) ?? 0), 0);
    return rise < 0 ? null : rise / Math.max(now.at - before.at, 1e-3);
};
/** What a histogram's newest entries are on average, in milliseconds. */
const mean = (name: string, apart = "") => (now: Sample, before: Sample) => {
    const rise = (part: string) => (now.values.get(`${name}_${part}${apart}`) ?? 0) - (before.values.get(`${name}_${part}${apart}`) ?? 0);
    return rise("count") > 0 ? (1000 * rise("sum")) / rise("count") : null;
};

const each = (value: number) => Number.isInteger(value) ? String(value) : value < 10 ? value.toFixed(value < 1 ? 2 : 1) : value.toFixed(0);
const MS = (value: number) => `${each(value)} ms`;
const PER_S = (value: number) => `${each(value)}/s`;

const CHARTS: Chart[] = [
    { title: "Frames", show: PER_S, lines: [
        ["all", rate("waypost_frames_total")],
        ["loop closures", rate("waypost_frames_total loop_closure")],
    ] },
    { title: "Time of a frame", show: MS, lines: [
        ["in all", mean("waypost_frame_duration_seconds", " total")],
        ["features", mean("waypost_frame_duration_seconds", " extract")],
        ["commit", mean("waypost_frame_duration_seconds", " commit")],
    ] },
    { title: "Requests", show: PER_S, lines: [["REST", rate("waypost_http_requests_total")], ["gRPC", rate("waypost_grpc_requests_total")]] },
    { title: "Time of a REST request", show: MS, lines: [["mean", mean("waypost_http_request_duration_seconds")]] },
    { title: "Open", show: each, lines: [
        ["streams", level("waypost_open_streams")], ["maps", level("waypost_open_maps")], ["jobs", level("waypost_jobs_running")],
    ] },
    { title: "Database", show: bytes, lines: [["size", level("waypost_database_bytes")]] },
];

export function Metrics() {
    const { samples, error } = useHour();
    const dark = useDark();
    return (
        <section class="panel" aria-label="Metrics">
            <header><h2>Metrics</h2><p class="quiet small">Over the last hour, as long as the server was there. <code>/metrics</code> is for Prometheus.</p></header>
            {error && <Refused error={error} />}
            <div class="plots">{CHARTS.map((chart) => <Plot key={chart.title} chart={chart} samples={samples} dark={dark} />)}</div>
        </section>
    );
}

/** A few minutes at least, so that the first lines do not rush by. */
function spread(from: number | null, to: number | null): [number, number] {
    // Of a single moment, uPlot would make a day.
    const end = Math.min(to ?? Infinity, Date.now() / 1000);
    return [Math.min(from ?? end, end - 300), end];
}

const PLOT_PX = 118;
const AXIS_PX = 58;
const DASHES = [[], [6, 3], [2, 3]];

function Plot({ chart, samples, dark }: { chart: Chart; samples: Sample[]; dark: boolean }) {
    const [box, { width }] = useSize<HTMLDivElement>();
    const plot = useRef<uPlot | null>(null);
    const data = useMemo((): uPlot.AlignedData => [
        samples.slice(1).map(({ at }) => at),
        ...chart.lines.map(([, of]) => samples.slice(1).map((now, before) => of(now, samples[before]!))),
    ], [samples, chart]);
    const newest = useRef(data);
    newest.current = data;
    useEffect(() => {
        if (!box.current || !width) return;
        const { faint, line, accent, closure } = ink(box.current);
        const axis = { stroke: faint, grid: { stroke: line, width: 1 }, ticks: { show: false }, font: "11px system-ui" };
        const colours = [accent, closure, faint];
        const made = new uPlot({
            width, height: PLOT_PX,
            padding: [6, 20, 0, 0],
            legend: { show: false },
            cursor: { show: false },
            scales: { x: { range: (_, from, to) => spread(from, to) }, y: { range: (_, __, most) => [0, (most || 1) * 1.1] } },
            axes: [
                { ...axis, size: 22, space: 60, values: (_, at) => at.map((seconds) => new Date(seconds * 1000).toTimeString().slice(0, 5)) },
                { ...axis, size: AXIS_PX, space: 28, values: (_, at) => at.map((value) => chart.show(value)) },
            ],
            series: [{}, ...chart.lines.map(([label], at) => ({
                label, stroke: colours[at]!, width: 1.75, dash: DASHES[at]!, points: { show: false }, spanGaps: false,
            }))],
        }, newest.current, box.current);
        plot.current = made;
        return () => {
            plot.current = null;
            made.destroy();
        };
    }, [width, dark, chart]);
    useEffect(() => plot.current?.setData(data), [data]);
    const last = chart.lines.map(([label], at) => {
        const values = data[at + 1] as (number | null)[];
        const value = values.at(-1) ?? null;
        return { label, told: value === null ? "none" : chart.show(value) };
    });
    return (
        <figure class="metric">
            <figcaption>{chart.title}</figcaption>
            <div class="plot" ref={box} role="img" aria-label={`${chart.title}: ${last.map(({ label, told }) => `${label} ${told}`).join(", ")}`} />
            <p class="legend" aria-hidden="true">{last.map(({ label, told }, at) => <span key={label} class={`key line-${at}`}>{label} <b>{told}</b></span>)}</p>
        </figure>
    );
}
