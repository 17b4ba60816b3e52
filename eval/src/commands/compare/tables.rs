//! The one table, for people and for programs.

use std::fmt::Write;

use serde::Serialize;

use super::ComparedRun;

/// A Markdown table, fractions in percent.
pub(super) fn markdown(runs: &[ComparedRun]) -> String {
    let mut table = "| sequence | configuration | recall at 100 % precision | average precision | proposals true / false | \
                     accepted / false | calibration error | ms per frame |\n|---|---|---|---|---|---|---|---|\n"
        .to_owned();
    let percent =
        |fraction: Option<f64>| fraction.map_or("–".to_owned(), |value| format!("{:.1}", 100.0 * value));
    let mut in_order: Vec<&ComparedRun> = runs.iter().collect();
    in_order.sort_by_key(|run| runs.iter().position(|first| first.sequence == run.sequence));
    for ComparedRun { configuration, sequence, report } in in_order {
        let accepted = match (report.accepted, report.accepted_false) {
            (Some(accepted), Some(wrong)) => format!("{accepted} / {wrong}"),
            (Some(_) | None, _) => "–".to_owned(),
        };
        let _ = writeln!(
            table,
            "| {sequence} | {configuration} | {} | {} | {} / {} | {accepted} | {} | {} |",
            percent(report.recall_at_100_precision),
            percent(report.average_precision),
            report.true_positives,
            report.false_positives,
            report.ece.map_or("–".to_owned(), |error| format!("{error:.3}")),
            report.ms_p50.total.map_or("–".to_owned(), |time| format!("{time:.1}")),
        );
    }
    table
}

/// One row a run, with a header; fractions lie in 0 to 1.
pub(super) fn csv(runs: &[ComparedRun]) -> csv::Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for ComparedRun { configuration, sequence, report } in runs {
        writer.serialize(Row {
            configuration,
            sequence,
            frames: report.frames,
            queries_with_loop: report.queries_with_loop,
            recall_at_100_precision: report.recall_at_100_precision,
            average_precision: report.average_precision,
            true_positives: report.true_positives,
            false_positives: report.false_positives,
            accepted: report.accepted,
            accepted_false: report.accepted_false,
            ece: report.ece,
            places: report.places,
            ms_p50_total: report.ms_p50.total,
        })?;
    }
    writer.into_inner().map_err(|error| error.into_error().into())
}

#[derive(Serialize)]
struct Row<'a> {
    configuration: &'a str,
    sequence: &'a str,
    frames: usize,
    queries_with_loop: usize,
    recall_at_100_precision: Option<f64>,
    average_precision: Option<f64>,
    true_positives: usize,
    false_positives: usize,
    accepted: Option<usize>,
    accepted_false: Option<usize>,
    ece: Option<f64>,
    places: Option<usize>,
    ms_p50_total: Option<f64>,
}
