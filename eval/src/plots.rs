//! Plots as SVG.

mod headings;
mod reliability;

pub(crate) use headings::{HeadingErrors, heading_errors_svg};
pub(crate) use reliability::reliability_svg;

use anyhow::{Context, Result};
use plotters::prelude::*;

use crate::precision_recall::PrecisionRecall;

const SIZE_PX: (u32, u32) = (720, 560);
const CURVE: RGBColor = RGBColor(20, 90, 170);
const CLEAN: RGBColor = RGBColor(200, 60, 0);

/// Precision over recall, with the point of the largest recall at 100 % precision marked. Empty
/// axes if there is no frame with a loop.
pub(crate) fn precision_recall_svg(title: &str, curve: &PrecisionRecall) -> Result<String> {
    let mut svg = String::new();
    draw(title, curve, &mut svg).context("the curve could not be drawn")?;
    Ok(svg)
}

fn draw(title: &str, curve: &PrecisionRecall, svg: &mut String) -> Result<()> {
    let percent = |fraction: Option<f64>| match fraction {
        Some(fraction) => format!("{:.1} %", 100.0 * fraction),
        None => "none (no loops)".to_owned(),
    };
    let clean = curve.recall_at_100_precision();
    let caption = format!(
        "recall at 100 % precision: {}, average precision: {}",
        percent(clean),
        percent(curve.average_precision())
    );
    let root = SVGBackend::with_string(svg, SIZE_PX).into_drawing_area();
    root.fill(&WHITE)?;
    let below_titles = root.titled(title, ("sans-serif", 20))?.titled(&caption, ("sans-serif", 15))?;
    let mut chart = ChartBuilder::on(&below_titles)
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..1.0, 0.0..1.02)?;
    chart
        .configure_mesh()
        .x_desc("recall")
        .y_desc("precision")
        .x_labels(11)
        .y_labels(11)
        .x_label_formatter(&|value| format!("{value:.1}"))
        .y_label_formatter(&|value| format!("{value:.1}"))
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 16))
        .light_line_style(WHITE)
        .draw()?;

    let points: Vec<(f64, f64)> = curve
        .points
        .iter()
        .filter_map(|point| curve.recall(point).map(|recall| (recall, point.precision())))
        .collect();
    let beginning = points.first().map(|&(_, precision)| (0.0, precision));
    let line = beginning.into_iter().chain(points);
    chart.draw_series(LineSeries::new(line, CURVE.stroke_width(2)))?;
    if let Some(recall) = clean {
        chart.draw_series([Circle::new((recall, 1.0), 5, CLEAN.filled())])?;
    }
    below_titles.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Verdict;
    use crate::precision_recall::JudgedProposal;

    #[test]
    fn the_plot_says_what_it_shows() {
        let proposals = [(0.9, Verdict::True), (0.8, Verdict::False), (0.7, Verdict::True)];
        let judged = proposals.map(|(score, verdict)| JudgedProposal { score, verdict });
        let curve = PrecisionRecall::sweep(judged.to_vec(), 4);
        let svg = precision_recall_svg("two loops of four", &curve).unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        assert!(svg.contains("two loops of four") && svg.contains("25.0 %"));
        assert_eq!(svg.matches("<polyline").count() - mesh_polylines(), 1);
    }

    #[test]
    fn without_loops_the_axes_are_empty() {
        let svg = precision_recall_svg("nothing", &PrecisionRecall::sweep(Vec::new(), 0)).unwrap();
        assert!(svg.contains("no loops") && !svg.contains("<circle"));
    }

    /// Axes are polylines too.
    fn mesh_polylines() -> usize {
        let svg = precision_recall_svg("", &PrecisionRecall::sweep(Vec::new(), 0)).unwrap();
        svg.matches("<polyline").count()
    }
}
