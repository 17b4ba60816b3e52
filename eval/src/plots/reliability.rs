//! The reliability diagram.

use anyhow::{Context, Result};
use plotters::prelude::*;

use crate::calibration::Reliability;

/// Share that is right over mean probability, one point a bin, beside the diagonal on which reported
/// probabilities are what they say. Empty axes without predictions.
pub(crate) fn reliability_svg(title: &str, reliability: &Reliability) -> Result<String> {
    let mut svg = String::new();
    draw(title, reliability, &mut svg).context("the reliability could not be drawn")?;
    Ok(svg)
}

const SIZE_PX: (u32, u32) = (760, 640);
const BINS: RGBColor = RGBColor(20, 90, 170);
const RIGHT: RGBColor = RGBColor(150, 150, 150);

fn draw(title: &str, reliability: &Reliability, svg: &mut String) -> Result<()> {
    let predictions: usize = reliability.bins.iter().map(|bin| bin.predictions).sum();
    let caption = match reliability.expected_calibration_error() {
        Some(error) => {
            format!("expected calibration error {error:.3}, {predictions} proposals, bins of equal mass")
        }
        None => "no proposal was judged".to_owned(),
    };
    let root = SVGBackend::with_string(svg, SIZE_PX).into_drawing_area();
    root.fill(&WHITE)?;
    let below_titles = root.titled(title, ("sans-serif", 18))?.titled(&caption, ("sans-serif", 15))?;
    let mut chart = ChartBuilder::on(&below_titles)
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..1.02, 0.0..1.02)?;
    chart
        .configure_mesh()
        .x_desc("probability reported")
        .y_desc("share that is right")
        .x_labels(11)
        .y_labels(11)
        .x_label_formatter(&|value| format!("{value:.1}"))
        .y_label_formatter(&|value| format!("{value:.1}"))
        .light_line_style(WHITE)
        .draw()?;
    chart.draw_series(LineSeries::new([(0.0, 0.0), (1.0, 1.0)], RIGHT.stroke_width(1)))?;
    let points: Vec<(f64, f64)> =
        reliability.bins.iter().map(|bin| (bin.mean_probability, bin.share_right)).collect();
    chart.draw_series(LineSeries::new(points.iter().copied(), BINS.stroke_width(2)))?;
    chart.draw_series(points.into_iter().map(|point| Circle::new(point, 4, BINS.filled())))?;
    below_titles.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Prediction;
    use crate::dataset::Verdict;

    #[test]
    fn every_bin_is_a_point() {
        let predictions: Vec<Prediction> = (0..30)
            .map(|i| Prediction { probability: f64::from(i) / 30.0, verdict: Verdict::False })
            .collect();
        let svg = reliability_svg("thirty", &Reliability::of(&predictions)).unwrap();
        assert_eq!(svg.matches("<circle").count(), 10);
        assert!(svg.contains("thirty") && svg.contains("30 proposals"));
        let empty = reliability_svg("none", &Reliability::of(&[])).unwrap();
        assert!(!empty.contains("<circle") && empty.contains("no proposal was judged"));
    }
}
