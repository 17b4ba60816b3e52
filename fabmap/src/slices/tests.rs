use super::*;
use proptest::prelude::*;

proptest! {
    #[test]
    fn exponentials_are_those_of_the_library(
        values in proptest::collection::vec(-1500.0..300.0f64, 0..70), origin in -100.0..100.0f64, scale in 0.1..1.0f64,
    ) {
        let mut results = vec![f64::NAN; values.len()];
        let total = exponentials(&values, origin, scale, &mut results);
        for (x, result) in values.iter().zip(&results) {
            let argument = (x - origin) * scale;
            let exact = if argument < -708.0 { 0.0 } else { argument.exp() };
            prop_assert!((result - exact).abs() <= 2e-15 * exact, "exp {argument}: {result} {exact}");
        }
        let plain: f64 = results.iter().sum();
        prop_assert!((total - plain).abs() <= 1e-14 * plain);
        let mut again = vec![0.0; values.len()];
        prop_assert_eq!(plain_exponentials(&values, origin, scale, &mut again).to_bits(), total.to_bits());
        prop_assert_eq!(again, results);
    }

    #[test]
    fn logarithms_are_those_of_the_library(
        pairs in proptest::collection::vec((0.0..1.0f64, 1e-90..1.0f64), 1..40), p in (0.0..1.0f64, 1e-9..1.0f64), q in (0.0..1.0f64, 1e-9..1.0f64),
    ) {
        let pairs: Vec<[f64; 2]> = pairs.into_iter().map(|(a, b)| [a, b]).collect();
        let (p, q) = ([p.0, p.1], [q.0, q.1]);
        let mut results = vec![f64::NAN; pairs.len()];
        log_ratios(&pairs, p, q, &mut results);
        for (&[a, b], result) in pairs.iter().zip(&results) {
            let exact = ((p[0] * a + p[1] * b) / (q[0] * a + q[1] * b)).ln();
            prop_assert!((result - exact).abs() <= 1e-15 + 4e-16 * exact.abs(), "{result} {exact}");
        }
    }

    #[test]
    fn sums_and_maxima(values in proptest::collection::vec(-900.0..900.0f64, 0..70), factor in -2.0..2.0f64) {
        prop_assert_eq!(largest(&values), values.iter().copied().fold(f64::NEG_INFINITY, f64::max));
        prop_assert!((sum(&values) - values.iter().sum::<f64>()).abs() < 1e-9);
        let mut scaled = values.clone();
        scale(&mut scaled, factor, 0.5);
        prop_assert!(scaled.iter().zip(&values).all(|(scaled, value)| *scaled == value * factor + 0.5));
    }
}

#[test]
fn the_logarithm_holds_from_end_to_end() {
    for x in
        [f64::MIN_POSITIVE, 1e-300, 0.5, 0.7071067811865475, 0.7071067811865477, 1.0, SQRT_2, 7e9, f64::MAX]
    {
        assert!((logarithm(x) - x.ln()).abs() <= 4e-16 * x.ln().abs(), "{x}: {} {}", logarithm(x), x.ln());
    }
}
