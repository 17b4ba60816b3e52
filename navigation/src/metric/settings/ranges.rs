//! Within what each number is taken.

use super::{
    AgainstTheWay, LocalizationSettings, PathSettings, PlanningSettings, Range, SteeringSettings,
    SupervisionSettings,
};

impl LocalizationSettings {
    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("map_m", self.map_m, 1e-3, 10.0),
            ("map_rad", self.map_rad, 1e-4, 1.0),
            ("closure_along_m", self.closure_along_m, 1e-3, 10.0),
            ("depth_m", self.depth_m, 0.0, 1000.0),
            ("along_m_per_ln_scale", self.along_m_per_ln_scale, 0.0, 100.0),
            ("closure_across_m", self.closure_across_m, 1e-3, 10.0),
            ("closure_heading_rad", self.closure_heading_rad, 1e-3, 1.0),
            ("drift_sigma_rad_per_m", self.drift_sigma_rad_per_m, 0.0, 1.0),
            ("scale_sigma", self.scale_sigma, 0.0, 0.5),
            ("way_noise", self.way_noise, 1e-4, 1.0),
            ("heading_noise", self.heading_noise, 1e-4, 1.0),
            ("turn_noise", self.turn_noise, 0.0, 1.0),
            ("gate_chi_squared", self.gate_chi_squared, 1.0, 1e6),
            ("contradictions", f64::from(self.contradictions), 1.0, 1000.0),
            ("least_evidence", self.least_evidence, 0.0, 1e6),
            ("confirmations", f64::from(self.confirmations), 1.0, 1000.0),
            ("found_along_m", self.found_along_m, 1e-3, 100.0),
            ("found_evidence", self.found_evidence, 0.0, 1e6),
            ("found_turn_rad", self.found_turn_rad, 1e-3, 3.2),
            ("search_evidence", self.search_evidence, 0.0, 1e6),
            ("search_rival", self.search_rival, 0.0, 1.0),
            ("agreement_m", self.agreement_m, 0.01, 10.0),
            ("agreement_rad", self.agreement_rad, 0.01, 3.2),
        ]
    }
}

impl PlanningSettings {
    pub(super) fn ranges(&self) -> Vec<Range> {
        let factor = match self.against {
            AgainstTheWay::Forbidden => 1.0,
            AgainstTheWay::Costs { factor } => factor,
        };
        vec![
            ("the factor against the way", factor, 1.0, 1e6),
            ("turn_m_per_rad", self.turn_m_per_rad, 0.0, 100.0),
            ("reach_m", self.reach_m, 0.01, 100.0),
        ]
    }
}

impl PathSettings {
    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("spacing_m", self.spacing_m, 1e-3, 0.1),
            ("rejoin_m", self.rejoin_m, 0.01, 10.0),
            ("target_m", self.target_m, 0.01, 10.0),
            ("window_m", self.window_m, 0.05, 100.0),
            ("arrived_m", self.arrived_m, 0.01, 10.0),
        ]
    }
}

impl SteeringSettings {
    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("speed_m_s", self.speed_m_s, 0.01, 10.0),
            ("max_turn_rad_s", self.max_turn_rad_s, 0.01, 10.0),
            ("proportional", self.proportional, 0.01, 100.0),
            ("integral", self.integral, 0.0, 100.0),
            ("derivative", self.derivative, 0.0, 100.0),
            ("max_integral_rad_s", self.max_integral_rad_s, 0.0, 10.0),
            ("slow_from_rad", self.slow_from_rad, 0.01, 3.2),
            ("stop_from_rad", self.stop_from_rad, self.slow_from_rad, 3.2),
            ("valid_ns", self.valid_ns as f64, 1e6, 60e9),
        ]
    }
}

impl SupervisionSettings {
    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("searching_m", self.searching_m, 0.01, 1000.0),
            ("searching_ns", self.searching_ns as f64, 1e6, 1e12),
            ("lost_sigma_m", self.lost_sigma_m, 0.01, 1000.0),
            ("lost_m", self.lost_m, 0.01, 1e6),
            ("lost_ns", self.lost_ns as f64, 1e6, 1e12),
            ("blind_ns", self.blind_ns as f64, 1e6, 1e12),
            ("lost_looks", f64::from(self.lost_looks), 1.0, 1e6),
            ("unknown_looks", f64::from(self.unknown_looks), 1.0, 1e6),
            ("unknown_looks_standing", f64::from(self.unknown_looks_standing), 1.0, 1e6),
            ("near_m", self.near_m, 0.01, 100.0),
            ("near_rad", self.near_rad, 0.01, 3.2),
            ("spin_rad_s", self.spin_rad_s, 0.01, 10.0),
            ("confirming_rad_s", self.confirming_rad_s, 0.0, 10.0),
            ("promising_evidence", self.promising_evidence, 0.0, 1e6),
            ("spin_rad", self.spin_rad, 0.0, 1e3),
            ("retreat_m", self.retreat_m, 0.0, 100.0),
            ("look_first_ns", self.look_first_ns as f64, 0.0, 60e9),
            ("blocked_ns", self.blocked_ns as f64, 1e6, 1e12),
            ("blocked_wait_ns", self.blocked_wait_ns as f64, 0.0, 1e12),
            ("back_off_m", self.back_off_m, 0.0, 100.0),
        ]
    }
}
