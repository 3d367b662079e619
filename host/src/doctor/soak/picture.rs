//! A soak as a picture: bars in the terminal, and an SVG.

use super::{Measured, microseconds};
use crate::histogram::{Histogram, Quantile};
use plotters::drawing::DrawingAreaErrorKind;
use plotters::prelude::*;

/// Bars of a picture.
const BARS: usize = 24;
/// Pixels.
const SIZE: (u32, u32) = (960, 480);

/// How many took how long: lower and upper end of a bar in ns, and its count. Bars are equally
/// wide by their logarithm, because the longest exchange may be a hundred times the median.
fn bars(histogram: &Histogram) -> Vec<(f64, f64, u64)> {
    let shortest = histogram.counted().next().map_or(1, |(nanos, _)| nanos);
    let (low, high) = (
        shortest.max(1) as f64,
        histogram.max().max(2) as f64 * 1.001,
    );
    let low = (low * 0.98).min(high * 0.9);
    let width = (high / low).ln() / BARS as f64;
    let mut bars: Vec<_> = (0..BARS)
        .map(|n| {
            let end = |n: usize| low * (width * n as f64).exp();
            (end(n), end(n + 1), 0)
        })
        .collect();
    for (nanos, count) in histogram.counted() {
        let place = ((nanos.min(histogram.max()) as f64 / low).ln() / width).max(0.0);
        bars[(place as usize).min(BARS - 1)].2 += count;
    }
    bars
}

/// For a terminal of so many columns.
pub fn text(histogram: &Histogram, columns: usize) -> String {
    let mut text = String::new();
    if histogram.total() == 0 {
        return text;
    }
    let bars = bars(histogram);
    let most = bars.iter().map(|bar| bar.2).max().unwrap_or(1).max(1);
    let room = columns.saturating_sub(26).clamp(10, 60);
    for (_, upto, count) in bars {
        // One of a million is seen, too.
        let length = (count * room as u64).div_ceil(most) as usize;
        let upto = microseconds(upto as u64);
        text += format!("{upto:>12} {count:>9} {}", "#".repeat(length)).trim_end();
        text.push('\n');
    }
    text
}

/// As SVG. The count has a logarithmic scale, so that the rare long ones are seen.
pub fn svg(measured: &Measured, title: &str) -> Result<String, String> {
    let mut svg = String::new();
    let failed = |error: DrawingAreaErrorKind<_>| format!("cannot draw the plot: {error}");
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE).map_err(failed)?;
        let histogram = &measured.exchange;
        let bars = bars(histogram);
        let most = bars.iter().map(|bar| bar.2).max().unwrap_or(0).max(1) as f64 * 1.5;
        let (low, high) = (bars[0].0 / 1e3, bars[BARS - 1].1 / 1e3);
        let mut chart = ChartBuilder::on(&root)
            .caption(title, ("sans-serif", 22))
            .margin(12)
            // Room for the name of the last line.
            .margin_right(48)
            .x_label_area_size(44)
            .y_label_area_size(70)
            .build_cartesian_2d((low..high).log_scale(), (0.5..most).log_scale())
            .map_err(failed)?;
        chart
            .configure_mesh()
            .x_desc("time of an exchange, us")
            .y_desc("exchanges")
            .x_label_formatter(&|us| format!("{us:.0}"))
            .y_label_formatter(&|count| format!("{count:.0}"))
            .draw()
            .map_err(failed)?;
        let drawn = bars
            .iter()
            .filter(|bar| bar.2 > 0)
            .map(|(from, to, count)| {
                let corners = [(from / 1e3, 0.5), (to / 1e3, *count as f64)];
                Rectangle::new(corners, BLUE.mix(0.6).filled())
            });
        chart.draw_series(drawn).map_err(failed)?;
        for (name, quantile) in [
            ("p50", Quantile::P50),
            ("p99", Quantile::P99),
            ("p99.9", Quantile::P99_9),
        ] {
            let at = histogram.quantile(quantile) as f64 / 1e3;
            let line = LineSeries::new([(at, 0.5), (at, most)], RED.mix(0.7));
            chart.draw_series(line).map_err(failed)?;
            let label = Text::new(name, (at, most), ("sans-serif", 14));
            chart.draw_series(core::iter::once(label)).map_err(failed)?;
        }
        root.present().map_err(failed)?;
    }
    Ok(svg)
}
