//! Two frames side by side, as SVG.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use fabmap::WordId;
use maud::{Markup, html};

use crate::service::queries::GateView;

/// Room for an image: it is scaled to fit in.
const PANEL_WIDTH: f64 = 640.0;
const MAX_PANEL_HEIGHT: f64 = 960.0;

/// Height where the size of the image is not known.
const USUAL_PANEL_HEIGHT: f64 = 480.0;

const GAP: f64 = 12.0;
const LINE_HEIGHT: f64 = 18.0;

/// Of a usual letter, at the size of the text: nobody knows here which font it will be.
const LETTER_WIDTH: f64 = 7.0;

/// Keypoints of a frame that are drawn, those in common first: more hide the image.
const MAX_MARKS: usize = 5000;

/// Green and red that those who confuse the two can tell by their brightness.
const COMMON: &str = "#3ddc5b";
const OTHER: &str = "#d7263d";
/// Of squares, which nothing else is.
const EXPECTED: &str = "#ffb000";

/// Half a square's side.
const HALF_SQUARE: f64 = 7.0;

/// Two frames, and what connects them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Picture {
    pub(super) heading: String,
    pub(super) verdict: Vec<GateView>,
    pub(super) summary: String,
    pub(super) panels: [Panel; 2],
    /// Marks of the first panel with those of the second.
    pub(super) joined: Vec<[usize; 2]>,
}

/// One of the frames.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Panel {
    pub(super) title: String,
    pub(super) image: Option<StillImage>,
    /// Width and height of the image that the marks are in.
    pub(super) size_px: Option<(u32, u32)>,
    pub(super) marks: Vec<Mark>,
    /// What is missing, and why.
    pub(super) notes: Vec<&'static str>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct StillImage {
    pub(super) content_type: &'static str,
    pub(super) bytes: Vec<u8>,
}

/// A feature, in pixels of its image: (0, 0) is the centre of the top left one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mark {
    pub(super) x_px: f64,
    pub(super) y_px: f64,
    pub(super) word: WordId,
    pub(super) kind: Kind,
}

/// Whether the other frame shows a mark's word, too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Common,
    /// It does not, though it should.
    Expected,
    Other,
}

/// Where a panel lies in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Frame {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
    /// Of the picture, for a pixel of the image.
    scale: f64,
}

impl Picture {
    /// The picture, referring to nothing outside. All text is escaped by `html!`.
    pub(super) fn to_svg(&self) -> String {
        let Self { heading, verdict, summary, panels, joined } = self;
        let width = 2.0 * PANEL_WIDTH + 3.0 * GAP;
        let most = ((width - 2.0 * GAP) / LETTER_WIDTH) as usize;
        let verdict: Vec<(bool, String)> = verdict.iter().flat_map(|gate| lines(gate, most)).collect();
        let summary = wrapped(summary, most);
        let legend = 1 + verdict.len() + summary.len();
        let top = GAP + LINE_HEIGHT * (1 + legend) as f64;
        let left = |index: usize| GAP + index as f64 * (PANEL_WIDTH + GAP);
        let frames = [0, 1].map(|index| panels[index].frame(left(index), top));
        let bottom = frames.iter().map(|frame| frame.top + frame.height).fold(0.0, f64::max);
        let notes = panels.iter().map(|panel| panel.notes.len()).max().unwrap_or(0);
        let height = bottom + GAP + LINE_HEIGHT * (1 + notes) as f64;
        let is_joined = [0, 1].map(|side| panels[side].is_joined(joined.iter().map(|pair| pair[side])));
        let svg = html! {
            svg xmlns="http://www.w3.org/2000/svg" viewBox={ "0 0 " (width) " " (number(height)) }
                width=(width) height=(number(height)) font-family="sans-serif" font-size="13" {
                rect width="100%" height="100%" fill="white" {}
                text x=(GAP) y=(line(0)) font-weight="bold" { (heading) }
                @for (row, (passed, text)) in (1..).zip(&verdict) {
                    text x=(GAP) y=(line(row)) fill=(if *passed { "#1a7f37" } else { OTHER }) { (text) }
                }
                @for (row, text) in (1 + verdict.len()..).zip(&summary) {
                    text x=(GAP) y=(line(row)) { (text) }
                }
                text x=(GAP) y=(line(legend)) {
                    tspan fill="#1a7f37" { "green: word in common, or joined" } "; "
                    tspan fill=(OTHER) { "red: neither" }
                    @if self.expects() { "; " tspan fill="#8a5a00" { "squares: expected in the other, and not seen" } }
                }
                @for (panel, (frame, joined)) in panels.iter().zip(frames.iter().zip(&is_joined)) {
                    (panel.draw(frame, joined, bottom))
                }
                g stroke=(COMMON) stroke-opacity="0.45" {
                    @for &[ours, theirs] in joined { (self.join(&frames, ours, theirs)) }
                }
            }
        };
        svg.into_string()
    }

    fn expects(&self) -> bool {
        self.panels.iter().flat_map(|panel| &panel.marks).any(|mark| mark.kind == Kind::Expected)
    }

    fn join(&self, [here, there]: &[Frame; 2], ours: usize, theirs: usize) -> Markup {
        let [first, second] = &self.panels;
        let ends = first.marks.get(ours).and_then(|mark| here.locate(mark));
        let ends = ends.zip(second.marks.get(theirs).and_then(|mark| there.locate(mark)));
        html! {
            @if let Some(((x1, y1), (x2, y2))) = ends {
                line x1=(number(x1)) y1=(number(y1)) x2=(number(x2)) y2=(number(y2)) {}
            }
        }
    }
}

/// What a gate says, in lines of at most so many letters, with whether it was passed.
fn lines(gate: &GateView, most: usize) -> Vec<(bool, String)> {
    let sign = if gate.gate.passed { "+" } else { "-" };
    let text = format!("{sign} {}", gate.description);
    wrapped(&text, most).into_iter().map(|line| (gate.gate.passed, line)).collect()
}

/// A text in lines of at most so many letters.
fn wrapped(text: &str, most: usize) -> Vec<String> {
    let mut words = text.split(' ');
    let mut lines = Vec::from_iter(words.next().map(str::to_owned));
    for word in words {
        match lines.last_mut().filter(|line| line.chars().count() + 1 + word.chars().count() <= most) {
            Some(line) => {
                line.push(' ');
                line.push_str(word);
            }
            None => lines.push(format!("   {word}")),
        }
    }
    lines
}

impl Panel {
    fn frame(&self, left: f64, top: f64) -> Frame {
        let Some((width_px, height_px)) = self.size_px else {
            return Frame { left, top, width: PANEL_WIDTH, height: USUAL_PANEL_HEIGHT, scale: 1.0 };
        };
        let width_px = f64::from(width_px.max(1));
        let height_px = f64::from(height_px.max(1));
        let scale = (PANEL_WIDTH / width_px).min(MAX_PANEL_HEIGHT / height_px);
        Frame { left, top, width: width_px * scale, height: height_px * scale, scale }
    }

    /// Which marks are joined with one of the other panel.
    fn is_joined(&self, joined: impl Iterator<Item = usize>) -> Vec<bool> {
        let mut is_joined = vec![false; self.marks.len()];
        for index in joined {
            if let Some(is_joined) = is_joined.get_mut(index) {
                *is_joined = true;
            }
        }
        is_joined
    }

    fn draw(&self, frame: &Frame, joined: &[bool], captions_top: f64) -> Markup {
        let Frame { left, top, width, height, .. } = *frame;
        let marks =
            self.marks.iter().zip(joined).map(|(mark, joined)| (mark, mark.kind == Kind::Common || *joined));
        let (common, others): (Vec<_>, Vec<_>) = marks.partition(|(_, common)| *common);
        let others_drawn = others.len().min(MAX_MARKS.saturating_sub(common.len()));
        // A thumbnail is of the same view, but for the rounding of its height.
        let fit = if self.size_px.is_some() { "none" } else { "xMidYMid meet" };
        html! {
            rect x=(left) y=(top) width=(number(width)) height=(number(height)) fill="#d0d0d0" {}
            @if let Some(StillImage { content_type, bytes }) = &self.image {
                // As the camera stood, which the file may say beside its rows: keypoints are of that.
                image x=(left) y=(top) width=(number(width)) height=(number(height)) preserveAspectRatio=(fit)
                    style="image-orientation:from-image"
                    href={ "data:" (content_type) ";base64," (STANDARD.encode(bytes)) } {}
            }
            (circles(OTHER, others.iter().take(others_drawn).map(|(mark, _)| *mark), frame))
            (circles(COMMON, common.iter().take(MAX_MARKS).map(|(mark, _)| *mark), frame))
            (squares(others.iter().map(|(mark, _)| *mark).filter(|mark| mark.kind == Kind::Expected), frame))
            text x=(left) y=(number(captions_top + LINE_HEIGHT)) { (self.title) }
            @for (row, note) in (2..).zip(&self.notes) {
                text x=(left) y=(number(captions_top + LINE_HEIGHT * f64::from(row))) fill="#555" { (note) }
            }
        }
    }
}

fn circles<'a>(colour: &str, marks: impl Iterator<Item = &'a Mark>, frame: &Frame) -> Markup {
    html! {
        g stroke=(colour) fill="none" stroke-width="1.5" {
            @for mark in marks {
                @if let Some((x, y)) = frame.locate(mark) {
                    circle cx=(number(x)) cy=(number(y)) r="3" { title { "word " (mark.word) } }
                }
            }
        }
    }
}

/// Around what the other frame was expected to show.
fn squares<'a>(marks: impl Iterator<Item = &'a Mark>, frame: &Frame) -> Markup {
    let side = 2.0 * HALF_SQUARE;
    html! {
        g stroke=(EXPECTED) fill="none" stroke-width="2.5" {
            @for mark in marks {
                @if let Some((x, y)) = frame.locate(mark) {
                    rect x=(number(x - HALF_SQUARE)) y=(number(y - HALF_SQUARE)) width=(side) height=(side) {
                        title { "word " (mark.word) ", expected" }
                    }
                }
            }
        }
    }
}

impl Frame {
    /// Where a mark is in the picture; nowhere if it lies outside its image.
    fn locate(&self, mark: &Mark) -> Option<(f64, f64)> {
        let x = (mark.x_px + 0.5) * self.scale;
        let y = (mark.y_px + 0.5) * self.scale;
        let inside = (0.0..=self.width).contains(&x) && (0.0..=self.height).contains(&y);
        inside.then_some((self.left + x, self.top + y))
    }
}

/// Baseline of a line of text above the panels.
fn line(row: usize) -> String {
    number(GAP + LINE_HEIGHT * (row as f64 + 0.5))
}

/// Tenths are as fine as anyone sees.
fn number(value: f64) -> String {
    format!("{value:.1}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(marks: Vec<Mark>) -> Panel {
        let title = "a < b".to_owned();
        Panel { title, image: None, size_px: Some((1280, 720)), marks, notes: Vec::new() }
    }

    fn mark(x_px: f64, y_px: f64, kind: Kind) -> Mark {
        Mark { x_px, y_px, word: WordId::new(7), kind }
    }

    fn drawn(left: Vec<Mark>, right: Vec<Mark>, joined: Vec<[usize; 2]>) -> String {
        let panels = [panel(left), panel(right)];
        let picture =
            Picture { heading: String::new(), verdict: Vec::new(), summary: String::new(), panels, joined };
        picture.to_svg()
    }

    #[test]
    fn marks_lie_where_their_pixels_are() {
        let svg = drawn(vec![mark(639.5, 359.5, Kind::Common)], Vec::new(), Vec::new());
        // The middle of the first panel, below three lines of text.
        assert!(svg.contains(r#"<circle cx="332.0" cy="246.0" r="3">"#) && svg.contains("a &lt; b"), "{svg}");
    }

    #[test]
    fn squares_mark_what_was_expected_and_is_joined_with_nothing() {
        let expected = mark(639.5, 359.5, Kind::Expected);
        let other = mark(5.0, 5.0, Kind::Other);
        let told = "squares: expected";
        let svg = drawn(vec![other], vec![expected, other], Vec::new());
        let square = r#"<rect x="977.0" y="239.0" width="14" height="14"><title>word 7, expected</title>"#;
        assert!(svg.contains(square) && svg.contains(told) && svg.matches("<circle").count() == 3, "{svg}");
        let svg = drawn(vec![other], vec![expected], vec![[0, 0]]);
        assert!(!svg.contains("<title>word 7, expected"), "{svg}");
        let svg = drawn(vec![other], vec![other], Vec::new());
        assert!(!svg.contains(told), "{svg}");
    }

    #[test]
    fn long_lines_go_on_below() {
        assert_eq!(wrapped("+ short", 40), ["+ short"]);
        assert_eq!(wrapped("- one two three four", 10), ["- one two", "   three", "   four"]);
        // A word that is longer than a line stays whole.
        assert_eq!(wrapped("- 0123456789", 5), ["-", "   0123456789"]);
    }

    #[test]
    fn what_lies_nowhere_is_not_drawn() {
        let nowhere = [
            mark(f64::NAN, 5.0, Kind::Common),
            mark(5.0, f64::INFINITY, Kind::Other),
            mark(-9.0, 5.0, Kind::Common),
        ];
        let svg = drawn(nowhere.to_vec(), vec![mark(5.0, 5.0, Kind::Common)], vec![[0, 0], [9, 9]]);
        assert!(svg.matches("<circle").count() == 1 && !svg.contains("<line"), "{svg}");
    }

    #[test]
    fn of_too_many_marks_those_in_common_are_drawn() {
        let of = |kind| std::iter::repeat_n(mark(5.0, 5.0, kind), MAX_MARKS - 10);
        let svg = drawn(of(Kind::Other).chain(of(Kind::Common)).collect(), Vec::new(), Vec::new());
        let green = svg.split(COMMON).nth(1).unwrap();
        assert_eq!(svg.matches("<circle").count(), MAX_MARKS);
        assert_eq!(green.matches("<circle").count(), MAX_MARKS - 10);
    }
}
