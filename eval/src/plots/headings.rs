//! How far headings are off.

use anyhow::{Context, Result};
use plotters::prelude::*;

/// A histogram of errors, and what it is held against.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct HeadingErrors<'a> {
    /// Errors by class, 0 in the middle of the middle one.
    pub classes: &'a [usize],
    /// Width of a class, in radians.
    pub class_rad: f64,
    /// Errors beyond the outermost classes.
    pub outside: usize,
    /// Pairs of images that no motion joins.
    pub without_heading: usize,
    /// Root mean square of all errors, in radians.
    pub std_rad: f64,
    /// That of somebody else, drawn as a normal distribution of as many errors, in radians.
    pub published_std_rad: f64,
}

/// A bar for every class, on a logarithmic axis so that one error in thousands is seen, beside the normal distribution of
/// the published standard deviation.
pub(crate) fn heading_errors_svg(errors: &HeadingErrors<'_>) -> Result<String> {
    let mut svg = String::new();
    draw(errors, &mut svg).context("the headings could not be drawn")?;
    Ok(svg)
}

const SIZE_PX: (u32, u32) = (720, 440);
const MEASURED: RGBColor = RGBColor(20, 90, 170);
const PUBLISHED: RGBColor = RGBColor(200, 60, 0);

/// Where bars begin: a class with one error is to be seen.
const FLOOR: f64 = 0.5;

fn draw(errors: &HeadingErrors<'_>, svg: &mut String) -> Result<()> {
    let HeadingErrors { classes, class_rad, outside, without_heading, std_rad, published_std_rad } = *errors;
    let within: usize = classes.iter().sum();
    let all = within + outside;
    let half_rad = class_rad * classes.len() as f64 / 2.0;
    let most = classes.iter().copied().max().unwrap_or(0).max(1) as f64;
    let title = format!("error of {all} headings: standard deviation {std_rad:.4} rad");
    let caption = format!(
        "{outside} beyond {half_rad:.3} rad, {without_heading} pairs without a heading, classes of {class_rad:.2} rad"
    );
    let root = SVGBackend::with_string(svg, SIZE_PX).into_drawing_area();
    root.fill(&WHITE)?;
    let below_titles = root.titled(&title, ("sans-serif", 20))?.titled(&caption, ("sans-serif", 15))?;
    let mut chart = ChartBuilder::on(&below_titles)
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(60)
        .build_cartesian_2d(-half_rad..half_rad, (FLOOR..2.0 * most).log_scale())?;
    chart
        .configure_mesh()
        .x_desc("error of the heading in radians")
        .y_desc("pairs of images")
        .x_labels(13)
        // No minus before zero.
        .x_label_formatter(&|error| format!("{:.2}", (error / class_rad).round() * class_rad + 0.0))
        .y_label_formatter(&|count| format!("{count:.0}"))
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 16))
        .light_line_style(WHITE)
        .draw()?;

    let from = |class: usize| class_rad * class as f64 - half_rad;
    let bars = classes.iter().enumerate().filter(|(_, count)| **count > 0).map(|(class, &count)| {
        Rectangle::new([(from(class), FLOOR), (from(class + 1), count as f64)], MEASURED.filled())
    });
    chart
        .draw_series(bars)?
        .label("measured")
        .legend(|(x, y)| Rectangle::new([(x, y - 5), (x + 20, y + 5)], MEASURED.filled()));
    let normal = (0..=200).map(|step| {
        let error = half_rad * (f64::from(step) / 100.0 - 1.0);
        (error, all as f64 * class_rad * normal_density(error, published_std_rad))
    });
    chart
        .draw_series(LineSeries::new(normal, PUBLISHED.stroke_width(2)))?
        .label(format!("published: {published_std_rad} rad, if normal"))
        .legend(|(x, y)| PathElement::new([(x, y), (x + 20, y)], PUBLISHED.stroke_width(2)));
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .label_font(("sans-serif", 14))
        .border_style(BLACK)
        .background_style(WHITE)
        .draw()?;
    below_titles.present()?;
    Ok(())
}

fn normal_density(error: f64, std: f64) -> f64 {
    (-0.5 * (error / std).powi(2)).exp() / (std * std::f64::consts::TAU.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_class_that_has_errors_is_a_bar() {
        let draw = |classes: &[usize], outside| {
            let errors = HeadingErrors {
                classes,
                class_rad: 0.1,
                outside,
                without_heading: 7,
                std_rad: 0.0456,
                published_std_rad: 0.31,
            };
            heading_errors_svg(&errors).unwrap()
        };
        // Beside the bars: the paper, the legend's box and its sample.
        let beside = draw(&[0; 5], 0).matches("<rect").count();
        let svg = draw(&[1, 0, 900, 3, 0], 2);
        assert_eq!(svg.matches("<rect").count() - beside, 3);
        for said in
            ["906 headings", "0.0456 rad", "2 beyond 0.250 rad", "7 pairs without", "published: 0.31 rad"]
        {
            assert!(svg.contains(said), "{said}");
        }
    }
}
