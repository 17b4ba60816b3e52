// Robots in the drawing: where each is, which way it looks, and whether anybody hears of it.
import type { FrameAnswer, Navigation, Schemas } from "../rest";
import { short } from "../rest";
import type { Ink } from "./colours";
import { pose } from "./geometry";
import { boxOf, type Scene } from "./scene";

export type Spot = [x: number, y: number];

/** What a robot does: it is led, it lets the map grow, it only looks, or it was led and has no connection now. */
export type Doing = "led" | "streams" | "looks" | "gone";

export interface Standing {
    name: string;
    doing: Doing;
    at: Spot;
    /** Against the drawing's x, to the left; `null` where nobody knows. */
    heading: number | null;
}

/** Where something was last heard to be: in metres of a part, and at a place. */
export interface Heard {
    pose: Schemas["Pose"] | null;
    part: number | null;
    place: number | null;
}

export function heardOfLed({ guidance }: Navigation): Heard {
    const here = guidance?.localization;
    return {
        pose: here?.pose ?? null, part: here?.part ?? null,
        place: here?.place_number ?? guidance?.appearance?.subgoal_place_number ?? null,
    };
}

export function heardOfAnswer(answer: FrameAnswer | null | undefined): Heard {
    const here = answer?.map_pose;
    return { pose: here?.robot ?? null, part: here?.part ?? null, place: answer?.place_number ?? null };
}

export function spotOfPlace(scene: Scene, number: number | null | undefined): Spot | null {
    const at = typeof number === "number" ? scene.near(number) : undefined;
    return at === undefined ? null : [scene.corrected.x[at]!, scene.corrected.y[at]!];
}

/** Between the drawing and a part of the map that is not drawn yet, as a share of the drawing. */
const PART_GAP = 0.15;

/** A pose of a part of the map in the drawing, where parts lie side by side; a part that is new lies right of all. */
export function spotOfPose(scene: Scene, part: number | null | undefined, given: Schemas["Pose"] | null): Spot | null {
    const at = scene.kind === "metric" ? pose(given) : null;
    if (!at) return null;
    const aside = scene.apart.get(part ?? 0);
    if (aside !== undefined) return [at.x + aside, at.y];
    const { x } = boxOf(scene);
    return [x[1] + PART_GAP * (x[1] - x[0]) + 1 + at.x, at.y];
}

/** Where a robot stands in the drawing: in metres if it is known so well, else at its place. */
export function standing(scene: Scene, name: string, doing: Doing, heard: Heard): Standing | null {
    const metres = spotOfPose(scene, heard.part, heard.pose);
    if (metres) return { name: short(name), doing, at: metres, heading: pose(heard.pose)!.heading };
    const place = spotOfPlace(scene, heard.place);
    return place && { name: short(name), doing, at: place, heading: null };
}

const NEAR_PX = 16;
const APART_PX = 26;
const EDGE_PX = 4;
const MOST_LETTERS = 20;
const FONT = "600 12px system-ui, sans-serif";

/** A robot on the screen. Those that would hide each other are moved aside. */
interface Put {
    robot: Standing;
    name: string;
    spot: Spot;
    x: number;
    y: number;
}

type Screen = { x: (world: number) => number; y: (world: number) => number };

function put(context: CanvasRenderingContext2D, robots: Standing[], screen: Screen): Put[] {
    const groups: Put[][] = [];
    for (const robot of robots) {
        const spot: Spot = [screen.x(robot.at[0]), screen.y(robot.at[1])];
        const name = robot.name.length > MOST_LETTERS ? `${robot.name.slice(0, MOST_LETTERS - 1)}…` : robot.name;
        const one = { robot, name, spot, x: spot[0], y: spot[1] };
        const group = groups.find(([first]) => Math.hypot(first!.spot[0] - spot[0], first!.spot[1] - spot[1]) < NEAR_PX);
        if (group) group.push(one);
        else groups.push([one]);
    }
    for (const group of groups.filter(({ length }) => length > 1)) {
        const wide = group.map(({ name }) => Math.max(context.measureText(name).width + 10, APART_PX));
        let left = group[0]!.spot[0] - wide.reduce((sum, one) => sum + one, 0) / 2;
        group.forEach((one, at) => {
            one.x = left + wide[at]! / 2;
            one.y = group[0]!.spot[1];
            left += wide[at]!;
        });
    }
    return groups.flat();
}

/** Draws robots with their names, and tells where each is on the screen. */
export function paintRobots(context: CanvasRenderingContext2D, robots: Standing[], screen: Screen, width: number, ink: Ink): Spot[] {
    context.font = FONT;
    const all = put(context, robots, screen);
    for (const { robot, name, spot, x, y } of all) {
        const gone = robot.doing === "gone";
        if (x !== spot[0]) {
            context.beginPath();
            context.moveTo(...spot);
            context.lineTo(x, y);
            context.strokeStyle = ink.faint;
            context.lineWidth = 1;
            context.stroke();
        }
        outline(context, x, y, robot.heading);
        context.lineJoin = "round";
        context.strokeStyle = ink.back;
        context.lineWidth = 5;
        context.stroke();
        context.fillStyle = gone ? ink.back : ink.accent;
        context.fill();
        if (gone) {
            context.strokeStyle = ink.faint;
            context.lineWidth = 2;
            context.setLineDash([4, 3]);
            context.stroke();
            context.setLineDash([]);
        }
        const half = context.measureText(name).width / 2;
        const middle = Math.max(Math.min(x, width - half - EDGE_PX), half + EDGE_PX);
        context.textAlign = "center";
        context.textBaseline = "top";
        context.strokeStyle = ink.back;
        context.lineWidth = 4;
        context.strokeText(name, middle, y + 13);
        context.fillStyle = gone ? ink.faint : ink.text;
        context.fillText(name, middle, y + 13);
    }
    return robots.map((robot) => {
        const { x, y } = all.find((one) => one.robot === robot)!;
        return [x, y];
    });
}

/** An arrow head that points where the robot looks; where nobody knows, a disc. */
function outline(context: CanvasRenderingContext2D, x: number, y: number, heading: number | null) {
    context.beginPath();
    if (heading === null) {
        context.arc(x, y, 8, 0, 2 * Math.PI);
        return;
    }
    // On the screen, y goes down.
    const [cos, sin] = [Math.cos(heading), -Math.sin(heading)];
    for (const [along, aside] of [[13, 0], [-9, -9], [-4, 0], [-9, 9]] as const) {
        context.lineTo(x + cos * along - sin * aside, y + sin * along + cos * aside);
    }
    context.closePath();
}

const round = (value: number) => Math.round(value * 1000) / 1000;

/** What is drawn of robots, for programs that cannot see it. */
export function listed(robots: Standing[], spots: Spot[]): string {
    return JSON.stringify(robots.map(({ name, doing, heading }, index) => {
        const [x, y] = spots[index]!;
        return { name, doing, x: Math.round(x), y: Math.round(y), heading: heading === null ? null : round(heading) };
    }));
}

const DOES: Record<Doing, string> = { led: "is led", streams: "streams", looks: "looks", gone: "is not connected" };

/** The same in words. */
export function described(robots: Standing[]): string {
    return robots.map(({ name, doing }) => ` ${name} ${DOES[doing]}.`).join("");
}
