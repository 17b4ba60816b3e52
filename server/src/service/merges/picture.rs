//! Maps before and after, as in the overview paper's figure 5: trajectories blue, links within a session red, links
//! between sessions green.

use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use maud::{Markup, html};
use posegraph::{PlanarPose, Pose as _};
use topomap::ids::SessionId;
use topomap::log::{FrameEvent, MapEvent};

use crate::service::read_map::ReadMap;

const TRAJECTORY: &str = "#1459aa";
const WITHIN: &str = "#d01020";
const BETWEEN: &str = "#208050";

const PANEL_PX: f64 = 420.0;
const GAP_PX: f64 = 20.0;
const LINE_PX: f64 = 20.0;

/// Panels beside each other.
const COLUMNS: usize = 3;

/// Between the rows of a map without metres: one for each session.
const ROW_PX: f64 = 70.0;

/// How high a link between places that do not follow each other rises above their row, at most.
const ARC_PX: f64 = 40.0;

/// A map: where it is measured, of its parts the one with most places; else its places in the order in which they were made,
/// a row for each session.
pub(super) struct Panel {
    title: String,
    unit: Unit,
    trajectories: Vec<Vec<[f64; 2]>>,
    within: Vec<[[f64; 2]; 2]>,
    between: Vec<[[f64; 2]; 2]>,
}

/// What the positions in a panel are counted in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Unit {
    Metres,
    Pixels,
}

impl Panel {
    pub(super) fn of(title: &str, map: &ReadMap) -> Self {
        let measured = Self::measured(title, map);
        if measured.bounds().is_some() { measured } else { Self::in_order(title, map) }
    }

    fn in_order(title: &str, map: &ReadMap) -> Self {
        let poses = map.mapper.poses();
        let mut rows: BTreeMap<Option<SessionId>, Vec<PlaceId>> = BTreeMap::new();
        for place in PlaceId::first(map.mapper.map().places().len()) {
            rows.entry(poses.maker(place)).or_default().push(place);
        }
        let longest = rows.values().map(Vec::len).max().unwrap_or(0);
        let step_px = PANEL_PX / longest.saturating_sub(1).max(1) as f64;
        let at = |row: usize, index: usize| [index as f64 * step_px, -(row as f64) * ROW_PX - ARC_PX];
        let row_points = |(row, places): (usize, &Vec<PlaceId>)| {
            (0..places.len()).map(|index| at(row, index)).collect::<Vec<_>>()
        };
        let trajectories: Vec<Vec<[f64; 2]>> = rows.values().enumerate().map(row_points).collect();
        let placed: BTreeMap<PlaceId, [f64; 2]> =
            rows.values().flatten().copied().zip(trajectories.iter().flatten().copied()).collect();
        let mut panel = Self {
            title: title.to_owned(),
            unit: Unit::Pixels,
            trajectories,
            within: vec![],
            between: vec![],
        };
        for link in map.log.events.iter().filter_map(frame).filter_map(|event| event.link) {
            let Some((from, to)) = placed.get(&link.from).zip(placed.get(&link.to)) else { continue };
            let links = if from[1] == to[1] { &mut panel.within } else { &mut panel.between };
            links.push([*from, *to]);
        }
        panel
    }

    fn measured(title: &str, map: &ReadMap) -> Self {
        let poses = map.mapper.poses();
        let places = PlaceId::first(map.mapper.map().places().len());
        let mut sizes: BTreeMap<PlaceId, usize> = BTreeMap::new();
        places
            .clone()
            .filter_map(|place| poses.part(place))
            .for_each(|part| *sizes.entry(part).or_default() += 1);
        let largest = sizes.into_iter().max_by_key(|&(part, size)| (size, std::cmp::Reverse(part)));
        let part = largest.map(|(part, _)| part);
        let of_place = |place: PlaceId| poses.pose(place).copied().filter(|_| poses.part(place) == part);
        let at = |pose: PlanarPose| [pose.x_m(), pose.y_m()];
        let mut panel = Self {
            title: title.to_owned(),
            unit: Unit::Metres,
            trajectories: Vec::new(),
            within: Vec::new(),
            between: Vec::new(),
        };
        let mut paths: BTreeMap<SessionId, Vec<[f64; 2]>> = BTreeMap::new();
        for event in map.log.events.iter().filter_map(frame) {
            let map = map.mapper.map();
            let known = event.at.filter(|_| map.withdrawal_of(event.frame).is_none());
            let placed = event.decision.place.and_then(of_place).zip(known);
            if let Some((place, of_robot)) = placed {
                paths.entry(event.session).or_default().push(at(place.compose(of_robot.pose())));
            }
            let Some(link) = map.link_of(event.frame, event.link) else { continue };
            let Some((from, to)) = of_place(link.from).zip(of_place(link.to)) else { continue };
            let makers = [link.from, link.to].map(|place| poses.maker(place));
            let links = if makers[0] == makers[1] { &mut panel.within } else { &mut panel.between };
            links.push([at(from), at(to)]);
        }
        panel.trajectories = paths.into_values().collect();
        panel
    }

    /// Least and largest x and y.
    fn bounds(&self) -> Option<[[f64; 2]; 2]> {
        let mut points = self.trajectories.iter().flatten().chain(self.within.iter().flatten());
        let &first = points.next()?;
        Some(points.fold([first, first], |[least, most], point| {
            [[least[0].min(point[0]), least[1].min(point[1])], [most[0].max(point[0]), most[1].max(point[1])]]
        }))
    }

    /// Larger extent, if it is in metres.
    fn extent_m(&self) -> Option<f64> {
        let [least, most] = self.bounds().filter(|_| self.unit == Unit::Metres)?;
        Some((most[0] - least[0]).max(most[1] - least[1]))
    }

    fn height_px(&self, px_per_m: f64) -> f64 {
        self.bounds().map_or(0.0, |[least, most]| match self.unit {
            Unit::Metres => px_per_m * (most[1] - least[1]),
            Unit::Pixels => most[1] - least[1] + ARC_PX,
        })
    }

    fn draw(&self, left: f64, top: f64, px_per_m: f64) -> Markup {
        let bounds = self.bounds();
        let place = |[x, y]: [f64; 2]| {
            let [[x_min, _], [_, y_max]] = bounds.unwrap_or_default();
            match self.unit {
                Unit::Metres => [px_per_m * (x - x_min), px_per_m * (y_max - y)],
                Unit::Pixels => [x, -y],
            }
        };
        html! {
            g transform={ "translate(" (number(left)) " " (number(top)) ")" } {
                text x="0" y="14" {
                    tspan font-weight="bold" { (self.title) }
                    @if self.unit == Unit::Pixels { ": places in order, a row for each session" }
                }
                @if bounds.is_none() { text x="0" y="36" { "it has no places" } }
                g transform={ "translate(0 " (LINE_PX + 6.0) ")" } fill="none" stroke-linecap="round" {
                    @for path in &self.trajectories {
                        polyline stroke=(TRAJECTORY) stroke-width="3" stroke-opacity="0.55" points=(points(path, place)) {}
                    }
                    @if self.unit == Unit::Pixels {
                        @for [x, y] in self.trajectories.iter().flatten().map(|&point| place(point)) {
                            circle cx=(number(x)) cy=(number(y)) r="2" fill=(TRAJECTORY) {}
                        }
                        (arcs(&self.within, WITHIN, place))
                    } @else {
                        (lines(&self.within, WITHIN, place))
                    }
                    (lines(&self.between, BETWEEN, place))
                }
            }
        }
    }
}

/// All panels at one scale, referring to nothing outside. All text is escaped by `html!`.
pub(super) fn svg(panels: &[Panel]) -> String {
    let measured = panels.iter().filter_map(Panel::extent_m).reduce(f64::max);
    let largest_m = measured.unwrap_or(1.0).max(1.0);
    let px_per_m = PANEL_PX / largest_m;
    let tallest_px = panels.iter().map(|panel| panel.height_px(px_per_m)).fold(0.0, f64::max);
    let rows = panels.len().div_ceil(COLUMNS);
    let across = PANEL_PX + GAP_PX;
    let down = tallest_px + GAP_PX + 2.0 * LINE_PX;
    let width = GAP_PX + across * panels.len().min(COLUMNS) as f64;
    let height = GAP_PX + LINE_PX + down * rows as f64;
    let legend =
        [("trajectories", TRAJECTORY), ("links within a session", WITHIN), ("between sessions", BETWEEN)];
    let bar_m = 10_f64.powf((largest_m / 2.0).log10().floor());
    html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox={ "0 0 " (number(width)) " " (number(height)) }
            width=(number(width)) height=(number(height)) font-family="sans-serif" font-size="13" {
            rect width="100%" height="100%" fill="white" {}
            text x=(GAP_PX) y="20" {
                @for (what, colour) in legend { tspan fill=(colour) { "■ " } (what) "   " }
            }
            @if measured.is_some() {
                line x1=(number(width - GAP_PX - bar_m * px_per_m)) x2=(number(width - GAP_PX)) y1="24" y2="24"
                    stroke="black" stroke-width="2" {}
                text x=(number(width - GAP_PX)) y="18" text-anchor="end" { (bar_m) " m" }
            }
            @for (index, panel) in panels.iter().enumerate() {
                (panel.draw(
                    GAP_PX + across * (index % COLUMNS) as f64,
                    GAP_PX + LINE_PX + down * (index / COLUMNS) as f64,
                    px_per_m,
                ))
            }
        }
    }
    .into_string()
}

fn lines(links: &[[[f64; 2]; 2]], colour: &str, place: impl Fn([f64; 2]) -> [f64; 2]) -> Markup {
    let d = links.iter().map(|&[from, to]| {
        let [x1, y1] = place(from);
        let [x2, y2] = place(to);
        format!("M{} {}L{} {}", number(x1), number(y1), number(x2), number(y2))
    });
    html! { path stroke=(colour) stroke-width="1.2" d=(d.collect::<String>()) {} }
}

/// Links along a row: those between neighbours on it, others as arcs above it, the higher the further.
fn arcs(links: &[[[f64; 2]; 2]], colour: &str, place: impl Fn([f64; 2]) -> [f64; 2]) -> Markup {
    let d = links.iter().map(|&[from, to]| {
        let [x1, y1] = place(from);
        let [x2, y2] = place(to);
        // The curve rises half as high as what it is drawn towards.
        let rise_px = 2.0 * ARC_PX * (x2 - x1).abs() / PANEL_PX;
        let middle = (x1 + x2) / 2.0;
        let [x1, y1, x2, y2, middle, above] = [x1, y1, x2, y2, middle, y1 - rise_px].map(number);
        format!("M{x1} {y1}Q{middle} {above} {x2} {y2}")
    });
    html! { path stroke=(colour) stroke-width="1.2" d=(d.collect::<String>()) {} }
}

fn points(path: &[[f64; 2]], place: impl Fn([f64; 2]) -> [f64; 2]) -> String {
    let point = |&point: &[f64; 2]| place(point).map(number).join(",");
    path.iter().map(point).collect::<Vec<_>>().join(" ")
}

/// Tenths of a pixel are enough.
fn number(value: f64) -> String {
    format!("{value:.1}")
}

fn frame(event: &MapEvent) -> Option<&FrameEvent> {
    match event {
        MapEvent::Frame(event) => Some(event),
        MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
    }
}
