//! False accepts over the size of the map.

use plotters::prelude::*;

/// One method's line.
#[derive(Clone, Debug, PartialEq)]
pub struct FalseAccepts {
    /// Its name.
    pub method: &'static str,
    /// Places on the map, and the share of queries from somewhere new for which one was accepted.
    pub points: Vec<(usize, f64)>,
}

/// Share of false accepts over the number of places, on a logarithmic axis, a line per method.
///
/// # Errors
/// The plotting library's words.
pub fn false_accepts_svg(lines: &[FalseAccepts]) -> Result<String, String> {
    let mut svg = String::new();
    draw(lines, &mut svg).map_err(|error| error.to_string())?;
    Ok(svg)
}

const SIZE_PX: (u32, u32) = (720, 480);
const COLOURS: [RGBColor; 4] =
    [RGBColor(120, 120, 120), RGBColor(200, 60, 0), RGBColor(20, 90, 170), RGBColor(0, 130, 70)];

fn draw(lines: &[FalseAccepts], svg: &mut String) -> Result<(), Box<dyn std::error::Error>> {
    let sizes = || lines.iter().flat_map(|line| line.points.iter().map(|&(places, _)| places as f64));
    let (smallest, largest) = (sizes().fold(f64::INFINITY, f64::min), sizes().fold(1.0, f64::max));
    let root = SVGBackend::with_string(svg, SIZE_PX).into_drawing_area();
    root.fill(&WHITE)?;
    let below_title = root.titled("new places taken for known ones", ("sans-serif", 20))?;
    let mut chart = ChartBuilder::on(&below_title)
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(60)
        .build_cartesian_2d((smallest.min(largest) / 1.5..largest * 1.5).log_scale(), -0.01..1.0)?;
    chart
        .configure_mesh()
        .x_desc("places on the map")
        .y_desc("false accepts")
        .x_label_formatter(&|places| format!("{places:.0}"))
        .y_label_formatter(&|share| format!("{:.0} %", 100.0 * share))
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 16))
        .light_line_style(WHITE)
        .draw()?;
    for (line, colour) in lines.iter().zip(COLOURS.iter().cycle()) {
        let points: Vec<(f64, f64)> =
            line.points.iter().map(|&(places, share)| (places as f64, share)).collect();
        chart
            .draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?
            .label(line.method)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour.stroke_width(2)));
        chart.draw_series(points.into_iter().map(|point| Circle::new(point, 4, colour.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .label_font(("sans-serif", 14))
        .border_style(BLACK)
        .background_style(WHITE)
        .draw()?;
    below_title.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_method_has_its_line_and_its_points() {
        let line = |method, points: &[(usize, f64)]| FalseAccepts { method, points: points.to_vec() };
        let svg = false_accepts_svg(&[
            line("one", &[(100, 0.1), (1000, 0.5), (10_000, 0.9)]),
            line("two", &[(100, 0.0), (1000, 0.01), (10_000, 0.02)]),
        ])
        .unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("one") && svg.contains("two"));
        assert_eq!(svg.matches("<circle").count(), 6);
    }

    #[test]
    fn one_size_and_none_can_be_drawn() {
        let one = FalseAccepts { method: "one", points: vec![(500, 0.2)] };
        assert_eq!(false_accepts_svg(&[one]).unwrap().matches("<circle").count(), 1);
        assert!(false_accepts_svg(&[]).is_ok());
    }
}
