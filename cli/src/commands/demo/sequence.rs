//! The recorded walk that ships, from pixels to loop closures.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use serde::Serialize;
use waypost_client::{Client, SessionOptions, v1};

use super::super::stream::closure_line;
use super::folders::shipped_sequence;
use super::repeat::{self, Repeated};
use super::{Demo, Kept};
use crate::failure::Failure;
use crate::frame_row::FrameRow;
use crate::images::images_of;
use crate::moments::even;
use crate::names::short;
use crate::output::Output;
use crate::progress;
use crate::replay::{Recording, Replay};
use crate::robot_words::ContentMaker;
use crate::truth::{Truth, Verdict};

const MAP: &str = "demo";
const STAMP_RATE_HZ: f64 = 1.0;

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    frames: usize,
    refused: usize,
    frames_with_loop: usize,
    closures_right: usize,
    closures_wrong: usize,
    closures_unlabelled: usize,
    map: v1::Map,
    data_dir: String,
    closures: Vec<JudgedClosure>,
    /// What came of the simulated robot.
    taught: Repeated,
}

#[derive(Serialize)]
struct JudgedClosure {
    query_index: u64,
    match_index: u64,
    posterior: f64,
    /// By words and geometry together; null where nothing was verified.
    probability: Option<f64>,
    verdict: Verdict,
}

pub(super) async fn run(demo: &Demo, output: Output) -> Result<(), Failure> {
    let named = demo.data.as_ref().map(|folder| folder.join("sequence"));
    let sequence = named.map_or_else(shipped_sequence, Ok)?;
    let truth = truth_of(&sequence)?;
    let images = images_of(&sequence)?;
    let moments = even(images.len(), STAMP_RATE_HZ);
    let recording = Recording::Folder { images, moments };
    let replay = Replay { recording, pace_hz: None, contents: ContentMaker::Images };
    let ((driven, taught), kept) = demo
        .with_server(output, async |server, data_dir| {
            let client = Client::connect(&server.endpoint()).await?;
            let model = demo.model(&client, output).await?;
            output.line(format_args!(
                "model {}: {}, {} words",
                short(&model.name),
                model.extractor,
                model.words
            ))?;
            let driven = drive(&client, &model.name, &replay, &truth, output).await?;
            let picture = data_dir.join("taught.svg");
            let taught = repeat::run(&client, &model.name, &picture, output).await?;
            Ok((driven, taught))
        })
        .await?;
    report(driven, taught, &truth, &kept, output)
}

/// What came out of the stream.
struct Driven {
    rows: Vec<FrameRow>,
    closures: Vec<JudgedClosure>,
    map: v1::Map,
}

async fn drive(
    client: &Client,
    model: &str,
    replay: &Replay,
    truth: &Truth,
    output: Output,
) -> Result<Driven, Failure> {
    let creation = v1::CreateMapRequest { map_id: MAP.to_owned(), model: model.to_owned(), settings: None };
    client.create_map(creation).await?;
    let session = client.open_session(SessionOptions::new(MAP)).await?;
    let session_name = session.opened().session.clone();
    let count = replay.recording.count_after(0);
    output.line(format_args!("streaming {count} images into {session_name}\n"))?;

    let bar = progress::counter(output, "frames answered", count);
    let mut rows = Vec::new();
    let mut closures = Vec::new();
    replay
        .stream(session, 0, |row| {
            bar.inc(1);
            if let Some(closure) = judged(&row, truth) {
                let line = closure_line(&row, replay, &session_name);
                let verdict = closure.verdict.words();
                let matches = true_matches(closure.query_index, truth, replay);
                bar.suspend(|| output.line(format_args!("{line}  {verdict:12}  truth: {matches}")))?;
                closures.push(closure);
            }
            if let Some(message) = &row.refusal_message {
                bar.suspend(|| output.line(format_args!("{} refused: {message}", row.image)))?;
            }
            rows.push(row);
            Ok(())
        })
        .await?;
    bar.finish_and_clear();
    let map = client.map(MAP, v1::MapView::Full).await?;
    Ok(Driven { rows, closures, map })
}

/// A loop closure with what the labels say about it.
fn judged(row: &FrameRow, truth: &Truth) -> Option<JudgedClosure> {
    if row.reason != Some("loop_closure") {
        return None;
    }
    let query_index = row.sequence.checked_sub(1)?;
    let match_index = row.match_sequence?.checked_sub(1)?;
    let verdict = truth.verdict(query_index, match_index);
    let posterior = row.match_posterior?;
    Some(JudgedClosure { query_index, match_index, posterior, probability: row.match_probability, verdict })
}

fn true_matches(query_index: u64, truth: &Truth, replay: &Replay) -> String {
    let names: Vec<_> =
        truth.matches_of(query_index).filter_map(|index| replay.image_name(index + 1)).collect();
    if names.is_empty() { "none labelled".to_owned() } else { names.join(", ") }
}

fn report(
    driven: Driven,
    taught: Repeated,
    truth: &Truth,
    kept: &Kept,
    output: Output,
) -> Result<(), Failure> {
    let Driven { rows, closures, map } = driven;
    let of_verdict = |verdict| closures.iter().filter(|closure| closure.verdict == verdict).count();
    let report = Report {
        frames: rows.len(),
        refused: rows.iter().filter(|row| row.refusal_code.is_some()).count(),
        frames_with_loop: truth.frames_with_loop(),
        closures_right: of_verdict(Verdict::Right),
        closures_wrong: of_verdict(Verdict::Wrong),
        closures_unlabelled: of_verdict(Verdict::Unlabelled),
        map,
        data_dir: kept.data_dir.to_string_lossy().into_owned(),
        closures,
        taught,
    };
    output.result(&report, |out| write_report(&report, kept, out))?;
    if report.refused > 0 {
        return Err(Failure::FramesRefused { refused: report.refused, frames: report.frames });
    }
    if report.closures_right == 0 {
        return Err(Failure::DemoWithoutClosure);
    }
    Ok(())
}

fn write_report(report: &Report, kept: &Kept, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out)?;
    writeln!(out, "frames                      {:5}", report.frames)?;
    writeln!(out, "frames with a true loop     {:5}", report.frames_with_loop)?;
    writeln!(out, "loop closures, right        {:5}", report.closures_right)?;
    writeln!(out, "loop closures, wrong        {:5}", report.closures_wrong)?;
    writeln!(out, "loop closures, not labelled {:5}", report.closures_unlabelled)?;
    writeln!(out, "places in the map           {:5}", report.map.places)?;
    writeln!(out, "links in the map            {:5}", report.map.links)?;
    repeat::write(&report.taught, out)?;
    writeln!(out)?;
    kept.tell(out, MAP)
}

fn truth_of(sequence: &Path) -> Result<Truth, Failure> {
    let path = sequence.join("loops.csv");
    let loops = File::open(&path).map_err(Failure::file("read", &path))?;
    let ignored_path = sequence.join("ignore.csv");
    let ignored: Box<dyn Read> = match File::open(&ignored_path) {
        Ok(file) => Box::new(file),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Box::new(io::empty()),
        Err(error) => return Err(Failure::file("read", &ignored_path)(error)),
    };
    Truth::new(loops, ignored).map_err(|source| Failure::Truth { path, source })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closures_are_judged_by_index() {
        let loops = "query_index,match_index\n4,1\n";
        let truth = Truth::new(loops.as_bytes(), io::empty()).unwrap();
        let closure = |sequence, match_sequence| FrameRow {
            sequence,
            reason: Some("loop_closure"),
            match_sequence: Some(match_sequence),
            match_posterior: Some(0.99),
            ..FrameRow::default()
        };
        assert_eq!(judged(&closure(5, 2), &truth).unwrap().verdict, Verdict::Right);
        assert_eq!(judged(&closure(5, 3), &truth).unwrap().verdict, Verdict::Wrong);
        let other = FrameRow { reason: Some("below_threshold"), ..closure(5, 2) };
        assert!(judged(&other, &truth).is_none());
    }
}
