// Where the person is, as the hash of the page's address: what is shown can be shared.
import { useEffect, useState } from "preact/hooks";
import { sequenceOf, type Sequence } from "./sequence";

export type Colour = "session" | "time" | "space";
export type Shape = "ring" | "strip";

/** All that decides what the page shows. */
export interface Link {
    page: "maps" | "map" | "merges" | "operations";
    map: string;
    /** The number of a merge; without it, all of them. */
    merge: number | null;
    /** Maps that are to be merged, and the one that they go into. */
    sources: string[];
    target: string;
    /** How those after the first lie on it, in metres and degrees, where they are laid on each other by hand. */
    laid: [number, number, number][] | null;
    /** The cursor of time: a frame of a session. */
    session: string | null;
    frame: Sequence | null;
    /** A place that was picked; without it, the cursor's. */
    place: number | null;
    /** The place that the cursor's frame is shown beside; without it, the one that it was compared with. */
    beside: number | null;
    /** The map that the match matrix compares this one with, `.` for itself; without it, the matrix is closed. */
    matrix: string | null;
    /** Middle of the matrix and pixels a place, and the cell that was picked: its place above and the one beside. */
    cells: [number, number, number] | null;
    cell: [number, number] | null;
    colour: Colour | null;
    shape: Shape | null;
    /** Whether links are coloured by what is left over. */
    residuals: boolean;
    /** Whether loop closures are drawn. */
    closures: boolean;
    /** 0 is by odometry alone, 1 corrected by closures. */
    corrected: number;
    /** Middle of the picture and pixels per unit. */
    view: [number, number, number] | null;
    /** Whether the pair fills the page. */
    large: boolean;
    /** The two frames of a merge's match that fill the page, by their names. */
    pair: [string, string] | null;
    /** Whether the cursor goes with the newest frame. */
    follow: boolean;
}

export const START: Link = {
    page: "maps", map: "", merge: null, sources: [], target: "", laid: null, session: null, frame: null, place: null, beside: null,
    matrix: null, cells: null, cell: null, colour: null,
    shape: null, residuals: false, closures: true, corrected: 1, view: null, large: false, pair: null, follow: false,
};

const COLOURS = ["session", "time", "space"] as const;
const SHAPES = ["ring", "strip"] as const;

function one<T extends string>(of: readonly T[], value: string | null): T | null {
    return of.find((known) => known === value) ?? null;
}

function whole(value: string | null): number | null {
    return value !== null && /^\d{1,15}$/.test(value) ? Number(value) : null;
}

function decoded(part: string): string {
    try {
        return decodeURIComponent(part);
    } catch {
        return "";
    }
}

function viewOf(given: URLSearchParams, name = "view"): Link["view"] {
    const view = (given.get(name) ?? "").split(",").map(Number);
    const [x, y, scale] = view;
    return view.length === 3 && view.every(Number.isFinite) && scale! > 0 ? [x!, y!, scale!] : null;
}

function laidOf(given: string | null): Link["laid"] {
    if (given === null) return null;
    const lies = given.split(";").filter(Boolean).map((lie) => lie.split(",").map(Number));
    return lies.every((lie) => lie.length === 3 && lie.every(Number.isFinite)) ? (lies as [number, number, number][]) : [];
}

function cellOf(given: URLSearchParams): Link["cell"] {
    const [row, column] = (given.get("cell") ?? "").split(",").map(whole);
    return row == null || column == null ? null : [row, column];
}

/** Reads a hash; what it does not understand is as if it were not there. */
export function read(hash: string): Link {
    const [path = "", query = ""] = hash.replace(/^#\/?/, "").split("?", 2);
    const [page, map = ""] = path.split("/");
    if (page === "operations") return { ...START, page };
    const given = new URLSearchParams(query);
    if (page === "merges") {
        const sources = (given.get("maps") ?? "").split(",").filter(Boolean);
        const [frame, beside] = [given.get("frame"), given.get("beside")];
        return {
            ...START, page, merge: whole(map), sources, target: given.get("into") ?? "", view: viewOf(given),
            pair: frame && beside ? [frame, beside] : null, laid: laidOf(given.get("laid")),
        };
    }
    if (page !== "maps" || !map) return START;
    const corrected = Number(given.get("corrected") ?? "1");
    return {
        ...START,
        page: "map",
        map: decoded(map),
        session: given.get("session"),
        frame: sequenceOf(given.get("frame")),
        place: whole(given.get("place")),
        beside: whole(given.get("beside")),
        matrix: given.get("matrix") || null,
        cells: viewOf(given, "cells"),
        cell: cellOf(given),
        colour: one(COLOURS, given.get("colour")),
        shape: one(SHAPES, given.get("shape")),
        residuals: given.get("links") === "residual",
        closures: given.get("closures") !== "hidden",
        corrected: corrected >= 0 && corrected <= 1 ? corrected : 1,
        view: viewOf(given),
        large: given.get("large") === "1",
        follow: given.get("follow") === "1",
    };
}

/** The hash of a link; what is as it is from the beginning is left out. */
export function hash(link: Link): string {
    if (link.page === "operations") return "#/operations";
    if (link.page === "maps") return "#/maps";
    const given = new URLSearchParams();
    if (link.page === "merges") {
        if (link.merge === null && link.sources.length) given.set("maps", link.sources.join(","));
        if (link.merge === null && link.target) given.set("into", link.target);
        if (link.merge === null && link.laid) given.set("laid", link.laid.map(written).join(";"));
        if (link.view) given.set("view", written(link.view));
        if (link.merge !== null && link.pair) {
            given.set("frame", link.pair[0]);
            given.set("beside", link.pair[1]);
        }
        return `#/merges${link.merge === null ? "" : `/${link.merge}`}${asked(given)}`;
    }
    if (link.session !== null) given.set("session", link.session);
    if (link.frame !== null) given.set("frame", link.frame);
    if (link.place !== null) given.set("place", String(link.place));
    if (link.beside !== null) given.set("beside", String(link.beside));
    if (link.matrix) given.set("matrix", link.matrix);
    if (link.matrix && link.cells) given.set("cells", written(link.cells));
    if (link.matrix && link.cell) given.set("cell", link.cell.join(","));
    if (link.colour) given.set("colour", link.colour);
    if (link.shape) given.set("shape", link.shape);
    if (link.residuals) given.set("links", "residual");
    if (!link.closures) given.set("closures", "hidden");
    if (link.corrected !== 1) given.set("corrected", String(link.corrected));
    if (link.view) given.set("view", written(link.view));
    if (link.large) given.set("large", "1");
    if (link.follow) given.set("follow", "1");
    return `#/maps/${encodeURIComponent(link.map)}${asked(given)}`;
}

function written(view: [number, number, number]): string {
    return view.map((value) => Number(value.toPrecision(6))).join(",");
}

function asked(given: URLSearchParams): string {
    const query = given.toString();
    return query && `?${query}`;
}

export type Go = (change: Partial<Link>) => void;

/** What one comes back to by the browser's own button. A cursor that moves along, a view and a colour are none of it. */
const STEPS = ["page", "map", "merge", "session", "place", "beside", "large", "pair", "matrix"] as const;

/** The link, and what changes it. What a click opened is a step in the browser's history. */
export function useLink(): [Link, Go] {
    const [link, setLink] = useState(() => read(location.hash));
    useEffect(() => {
        const changed = () => setLink(read(location.hash));
        addEventListener("hashchange", changed);
        return () => removeEventListener("hashchange", changed);
    }, []);
    const go: Go = (change) => {
        setLink((link) => {
            const next = { ...link, ...change };
            const written = hash(next);
            if (written !== location.hash) {
                const step = STEPS.some((part) => next[part] !== link[part]) && !next.follow;
                history[step ? "pushState" : "replaceState"](null, "", written);
            }
            return next;
        });
    };
    return [link, go];
}
