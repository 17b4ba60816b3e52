//! Time over the size of the map.

use anyhow::{Context, Result};
use plotters::prelude::*;

/// Median time of a filter update, in milliseconds, over the number of places; both axes logarithmic, with the line
/// of proportional growth from the largest map down.
pub(crate) fn growth_svg(points: &[(usize, f64)]) -> Result<String> {
    let mut svg = String::new();
    draw(points, &mut svg).context("the growth could not be drawn")?;
    Ok(svg)
}

const SIZE_PX: (u32, u32) = (720, 480);
const MEASURED: RGBColor = RGBColor(20, 90, 170);
const PROPORTIONAL: RGBColor = RGBColor(120, 120, 120);

fn draw(points: &[(usize, f64)], svg: &mut String) -> Result<()> {
    let points: Vec<(f64, f64)> =
        points.iter().map(|&(places, milliseconds)| (places as f64, milliseconds.max(1e-6))).collect();
    let &(most, slowest) = points.last().context("nothing was measured")?;
    let proportional: Vec<(f64, f64)> = points.iter().map(|&(x, _)| (x, slowest * x / most)).collect();
    let all = || points.iter().chain(&proportional);
    let fewest = points.iter().map(|point| point.0).fold(most, f64::min);
    let (fastest, slowest) =
        all().fold((slowest, slowest), |(low, high), point| (low.min(point.1), high.max(point.1)));
    let root = SVGBackend::with_string(svg, SIZE_PX).into_drawing_area();
    root.fill(&WHITE)?;
    let below_title = root.titled("filter update as the map grows", ("sans-serif", 20))?;
    let mut chart = ChartBuilder::on(&below_title)
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(60)
        .build_cartesian_2d(
            (fewest / 1.5..most * 1.5).log_scale(),
            (fastest / 2.0..slowest * 2.0).log_scale(),
        )?;
    chart
        .configure_mesh()
        .x_desc("places on the map")
        .y_desc("milliseconds, median")
        .x_label_formatter(&|places| format!("{places:.0}"))
        .draw()?;
    for (name, line, colour) in
        [("measured", &points, MEASURED), ("proportional to places", &proportional, PROPORTIONAL)]
    {
        chart
            .draw_series(LineSeries::new(line.iter().copied(), colour.stroke_width(2)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
    }
    chart.configure_series_labels().background_style(WHITE).border_style(BLACK).draw()?;
    root.present()?;
    drop(chart);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_lines_are_drawn() {
        let svg = growth_svg(&[(100, 0.2), (200, 0.35), (1600, 2.0)]).unwrap();
        assert!(svg.contains("measured") && svg.contains("proportional to places"));
        assert!(growth_svg(&[]).is_err());
        assert!(growth_svg(&[(1, 0.5)]).unwrap().contains("measured"));
    }
}
