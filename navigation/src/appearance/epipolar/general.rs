//! Motion in space, by the eight-point algorithm. Hartley & Zisserman, Multiple View Geometry,
//! chapters 9 and 11.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Unit, Vector3};

use super::{Motion, RayPair, behind_both_rad};

/// A motion in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct GeneralMotion {
    rotation: Rotation3<f64>,
    direction: Unit<Vector3<f64>>,
}

impl GeneralMotion {
    /// φ = atan2(d_y, d_x), in (-π, π].
    pub(super) fn heading_rad(&self) -> f64 {
        self.direction.y.atan2(self.direction.x)
    }
}

impl Motion for GeneralMotion {
    const SAMPLE: usize = 8;

    fn rotation(&self) -> Rotation3<f64> {
        self.rotation
    }

    fn direction(&self) -> Unit<Vector3<f64>> {
        self.direction
    }

    /// Rays of length 1 need no normalisation. All four motions that share the essential matrix are
    /// tried.
    fn fit(pairs: &[RayPair]) -> Option<Self> {
        let mut moments = SMatrix::<f64, 9, 9>::zeros();
        for RayPair { current, target } in pairs {
            let row = SVector::<f64, 9>::from_fn(|entry, _| current[entry / 3] * target[entry % 3]);
            moments += row * row.transpose();
        }
        let eigen = moments.symmetric_eigen();
        let least = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        let mut svd = Matrix3::from_row_slice(least.as_slice()).try_svd(true, true, f64::EPSILON, 100)?;
        svd.sort_by_singular_values();
        let u = svd.u?;
        let v_t = svd.v_t?;
        let quarter = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        // E = R [t]ₓ = -[d]ₓ R up to sign, so d is what E has on its left that comes to nothing.
        let way = Unit::new_normalize(u.column(2).into_owned());
        let rotations = [quarter, quarter.transpose()].map(|turn| {
            let rotation = u * turn * v_t;
            Rotation3::from_matrix_unchecked(rotation * rotation.determinant().signum())
        });
        let four = rotations
            .into_iter()
            .flat_map(|rotation| [way, -way].map(|direction| Self { rotation, direction }));
        four.map(|motion| (behind_both_rad(&motion, pairs), motion))
            .min_by(|(a, _), (b, _)| a.total_cmp(b))
            .map(|(_, motion)| motion)
    }

    fn refined(self, _pairs: &[RayPair]) -> Self {
        self
    }
}
