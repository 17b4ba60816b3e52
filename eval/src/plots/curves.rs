//! Many precision-recall curves in one picture.

use plotters::prelude::*;

use crate::precision_recall::PrecisionRecall;

/// The curves of one sequence, each with its configuration's name.
pub struct Panel<'a> {
    /// The sequence's name.
    pub title: &'a str,
    /// Name and curve, in the order of the legend.
    pub curves: Vec<(&'a str, &'a PrecisionRecall)>,
}

/// Precision over recall, a panel beside the other for every sequence, a colour for every
/// configuration.
///
/// # Errors
/// The plotting library's words.
pub fn compared_curves_svg(panels: &[Panel<'_>]) -> Result<String, String> {
    let mut svg = String::new();
    draw(panels, &mut svg).map_err(|error| error.to_string())?;
    Ok(svg)
}

const PANEL_PX: (u32, u32) = (520, 480);

fn draw(panels: &[Panel<'_>], svg: &mut String) -> Result<(), Box<dyn std::error::Error>> {
    let beside = u32::try_from(panels.len().max(1))?;
    let root = SVGBackend::with_string(svg, (PANEL_PX.0 * beside, PANEL_PX.1)).into_drawing_area();
    root.fill(&WHITE)?;
    for (area, panel) in root.split_evenly((1, panels.len().max(1))).iter().zip(panels) {
        let mut chart = ChartBuilder::on(area)
            .caption(panel.title, ("sans-serif", 18))
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..1.0, 0.0..1.02)?;
        chart.configure_mesh().x_desc("recall").y_desc("precision").light_line_style(WHITE).draw()?;
        for (number, (name, curve)) in panel.curves.iter().enumerate() {
            let colour = Palette99::pick(number).to_rgba();
            let points: Vec<(f64, f64)> = curve
                .points()
                .iter()
                .filter_map(|point| curve.recall(point).map(|recall| (recall, point.precision())))
                .collect();
            let beginning = points.first().map(|&(_, precision)| (0.0, precision));
            let line = LineSeries::new(beginning.into_iter().chain(points), colour.stroke_width(2));
            let key = move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2));
            chart.draw_series(line)?.label(*name).legend(key);
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerLeft)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK)
            .draw()?;
    }
    root.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Verdict;
    use crate::precision_recall::JudgedProposal;

    #[test]
    fn panels_and_curves_are_named() {
        let proposals = vec![JudgedProposal { score: 0.9, verdict: Verdict::True }];
        let curve = PrecisionRecall::sweep(proposals, 2);
        let panel = |title| Panel { title, curves: vec![("plain", &curve), ("tempered", &curve)] };
        let svg = compared_curves_svg(&[panel("hall"), panel("street")]).unwrap();
        for name in ["hall", "street"] {
            assert_eq!(svg.matches(name).count(), 1, "{name}");
        }
        for name in ["plain", "tempered"] {
            assert_eq!(svg.matches(name).count(), 2, "{name}");
        }
    }
}
