use super::*;
use proptest::prelude::*;

fn texture(own: u64, own_share: f64) -> Texture {
    let surface = Surface { material: Material::Plaster, style: 1, family: 2, own, own_share };
    Texture::paint(&surface, 3.0, 2.0)
}

fn differing(a: &Texture, b: &Texture) -> f64 {
    let (a, b) = (&a.levels[0].texels, &b.levels[0].texels);
    a.iter().zip(b).filter(|(a, b)| a.abs_diff(**b) > 4).count() as f64 / a.len() as f64
}

#[test]
fn look_alikes_differ_in_the_share_that_is_their_own() {
    assert_eq!(texture(1, 0.0), texture(2, 0.0));
    let (some, all) =
        (differing(&texture(1, 0.2), &texture(2, 0.2)), differing(&texture(1, 1.0), &texture(2, 1.0)));
    assert!((0.03..0.45).contains(&some), "{some} of look-alikes differs");
    assert!(all > 2.0 * some && all > 0.5, "{all} of surfaces of their own differs, {some} of look-alikes");
}

proptest! {
    /// A pixel that sees much sees the mean of it: against the sum over all texels.
    #[test]
    fn coarse_looks_are_means(x in 1.0..2.0f32, y in 0.8..1.2f32, side in 0.05..0.3f32) {
        let texture = texture(5, 1.0);
        let footprint = Footprint { major_m: [side, 0.0], minor_m: side };
        let found = texture.sample(x, y, &footprint);
        let around = |reach: f32| {
            let texels = |middle: f32| {
                let bound = |metres: f32| (metres * texture.texels_per_m) as usize;
                bound(middle - reach * side)..bound(middle + reach * side)
            };
            let fine = &texture.levels[0];
            let row = |row: usize| texels(x).map(move |column| f32::from(fine.texels[column * fine.height + row]));
            texels(y).flat_map(row).collect::<Vec<f32>>()
        };
        // Of two levels the coarser may have texels of twice the side.
        let (near, all) = (around(1.0), around(2.5));
        let mean = near.iter().sum::<f32>() / near.len() as f32;
        let [least, most] = [f32::min, f32::max].map(|pick| all.iter().copied().reduce(pick).unwrap());
        prop_assert!((least..=most).contains(&found));
        prop_assert!((found - mean).abs() < 0.3 * (most - least) + 2.0, "{found}, not {mean}");
    }
}

proptest! {
    /// From near by a texel is what was painted.
    #[test]
    fn the_finest_looks_are_texels(column in 0..384_usize, row in 0..256_usize, side in 0.0..0.007f32) {
        let texture = texture(5, 1.0);
        let middle = |index: usize| (index as f32 + 0.5) / texture.texels_per_m;
        let footprint = Footprint { major_m: [0.0, side], minor_m: side / 2.0 };
        let found = texture.sample(middle(column), middle(row), &footprint);
        let painted = f32::from(texture.levels[0].texels[column * texture.levels[0].height + row]);
        prop_assert!((found - painted).abs() < 1.0, "{found}, not {painted}");
    }
}

#[test]
fn the_logarithm_is_exact_at_powers_of_two() {
    assert_eq!([1.0, 2.0, 64.0].map(log2), [0.0, 1.0, 6.0]);
    assert!((log2(3.0) - 3.0_f32.log2()).abs() < 0.09);
}
