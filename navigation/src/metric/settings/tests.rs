use super::*;

#[test]
fn defaults_are_in_range_and_what_is_not_is_named() {
    let mut settings = NavigationSettings::default();
    assert_eq!(settings.check(), Ok(()));
    settings.steering.speed_m_s = f64::NAN;
    assert_eq!(settings.check().unwrap_err().setting, "speed_m_s");
    settings = NavigationSettings::default();
    settings.planning.against = AgainstTheWay::Costs { factor: 0.5 };
    assert_eq!(settings.check().unwrap_err().setting, "the factor against the way");
    settings = NavigationSettings::default();
    settings.localization.confirmations = 0;
    assert_eq!(settings.check().unwrap_err().setting, "confirmations");
}
