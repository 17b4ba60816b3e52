use super::*;

/// Settings of which none has its default.
fn unusual() -> MapSettings {
    let mut settings = MapSettings::default().with_strategy(NavigationStrategy::Appearance);
    settings.keep = Keep::Images;
    let mapper = &mut settings.mapper;
    mapper.recognizer.dependence = Dependence::NaiveBayes;
    mapper.recognizer.new_place = NewPlaceMethod::MeanField;
    mapper.recognizer.detector = Some(DetectorModel::new(0.4, 0.02).unwrap());
    mapper.recognizer.filter.new_place_prior = 0.8;
    mapper.closure_threshold = 0.7;
    mapper.guard_frames = 3;
    mapper.verification.method = VerificationMethod::Epipolar;
    mapper.place_spacing = PlaceSpacing { distance_m: 0.25, angle_rad: 0.1 };
    settings
}

#[test]
fn settings_come_back_from_the_database() {
    for settings in [unusual(), MapSettings::default()] {
        assert_eq!(from_json(&to_json(&settings).unwrap()), Ok(settings));
    }
}

#[test]
fn the_stored_form_stays_as_it_is() {
    let stored = concat!(
        r#"{"dependence":"naive_bayes","new_place":"mean_field","#,
        r#""detector":{"true_positive_rate":0.4,"false_positive_rate":0.02},"#,
        r#""new_place_prior":0.8,"even_share":0.1,"likelihood_smoothing":1.0,"closure_threshold":0.7,"#,
        r#""guard_frames":3,"guard_measure":"way","looks_per_stay":3,"min_words":10,"#,
        r#""max_speed_m_per_s":100.0,"keep":"images","#,
        r#""verification":{"method":"epipolar","min_posterior":0.0,"min_inliers":8,"#,
        r#""max_rotation_rad":0.5,"max_ln_scale":0.8,"max_translation_widths":0.5,"#,
        r#""consistency_frames":8},"#,
        r#""metric":{"place_spacing_m":0.25,"place_spacing_rad":0.1,"translation_share":0.05,"#,
        r#""heading_rad_per_m":0.05,"turn_share":0.05,"position_floor_m":0.01,"#,
        r#""heading_floor_rad":0.01,"prior_frames":4},"navigation_strategy":"appearance"}"#,
    );
    assert_eq!(to_json(&unusual()).unwrap(), stored);
}

#[test]
fn numbers_come_back_to_the_bit() {
    let mut settings = MapSettings::default();
    settings.mapper.recognizer.filter.new_place_prior = 1.0 - f64::EPSILON / 2.0;
    for step in 0..1000_u32 {
        assert_eq!(from_json(&to_json(&settings).unwrap()), Ok(settings));
        // Irrational steps: numbers of all 17 digits.
        let number = (f64::from(step) * std::f64::consts::SQRT_2).fract();
        settings.mapper.closure_threshold = number;
        settings.mapper.recognizer.filter.new_place_prior = number.sqrt();
    }
}

#[test]
fn settings_as_version_0_1_wrote_them_still_open() {
    let stored = r#"{"dependence":"chow_liu","new_place":"sampled","detector":null,"new_place_prior":0.9,
        "even_share":0.1,"likelihood_smoothing":0.99,"closure_threshold":0.9,"guard_frames":20,
        "looks_per_stay":3,"min_words":10,"max_speed_m_per_s":100.0}"#;
    let settings = from_json(stored).unwrap();
    assert_eq!((settings.mapper.guard_frames, settings.keep), (20, Keep::Words));
    assert_eq!(settings.mapper.guard_measure, GuardMeasure::Frames);
    assert_eq!(settings.strategy, NavigationStrategy::TopoMetric);
    assert_eq!(settings.mapper.verification.method, VerificationMethod::None);
    assert_eq!(settings.mapper.recognizer.new_place, NewPlaceMethod::Sampled);
    assert_eq!(
        settings.mapper.place_spacing,
        PlaceSpacing { distance_m: 0.5, angle_rad: 10_f64.to_radians() }
    );
}

#[test]
fn appearance_takes_features() {
    let appearance = MapSettings::default().with_strategy(NavigationStrategy::Appearance);
    assert!(MapSettings { keep: Keep::Images, ..appearance }.check().is_ok());
    assert!(appearance.check().is_ok());
    let refused = MapSettings { keep: Keep::Words, ..appearance }.check().unwrap_err();
    assert!(refused.to_string().contains("keep features"), "{refused}");
}
