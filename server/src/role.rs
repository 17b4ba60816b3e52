//! What the holder of a token may do.

/// Role of a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Role {
    /// May read, and change nothing
    Reader,
    /// May stream into maps, query and read
    Robot,
    /// May do everything
    Admin,
}

impl Role {
    /// As it is stored and shown.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Role::Reader => "reader",
            Role::Robot => "robot",
            Role::Admin => "admin",
        }
    }

    pub(crate) fn of_name(name: &str) -> Option<Self> {
        [Role::Reader, Role::Robot, Role::Admin].into_iter().find(|role| role.name() == name)
    }

    /// All that it may do.
    pub(crate) fn abilities(self) -> Abilities {
        Abilities(match self {
            Role::Reader => vec![Ability::Read],
            Role::Robot => vec![Ability::Read, Ability::Localize, Ability::Stream, Ability::Navigate],
            Role::Admin => Ability::ALL.to_vec(),
        })
    }
}

/// One of the things that a token may be good for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Ability {
    /// Read maps, sessions, models, merges, jobs and metrics
    Read,
    /// Ask where an image or a robot is, without a trace in the map
    Localize,
    /// Let maps grow
    Stream,
    /// Be led along a map, send robots somewhere, and label places
    Navigate,
    /// Make, merge, export and delete maps, and look after models and tokens
    Admin,
}

impl Ability {
    const ALL: [Self; 5] = [Self::Read, Self::Localize, Self::Stream, Self::Navigate, Self::Admin];

    /// As it is stored and shown.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Ability::Read => "read",
            Ability::Localize => "localize",
            Ability::Stream => "stream",
            Ability::Navigate => "navigate",
            Ability::Admin => "admin",
        }
    }
}

/// What a token may do: at least one thing, each once and in one order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Abilities(Vec<Ability>);

impl Abilities {
    /// Of what was named, in any order; `None` if nothing was.
    pub(crate) fn of(mut named: Vec<Ability>) -> Option<Self> {
        named.sort();
        named.dedup();
        (!named.is_empty()).then_some(Self(named))
    }

    pub(crate) fn have(&self, ability: Ability) -> bool {
        self.0.contains(&ability)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = Ability> {
        self.0.iter().copied()
    }

    /// Those that `self` has and `other` has not.
    pub(crate) fn beyond(&self, other: &Self) -> Option<Self> {
        Self::of(self.iter().filter(|ability| !other.have(*ability)).collect())
    }

    /// As they are stored: names, with commas between them.
    pub(crate) fn to_text(&self) -> String {
        self.iter().map(Ability::name).collect::<Vec<_>>().join(",")
    }

    pub(crate) fn of_text(text: &str) -> Option<Self> {
        let of_name = |name| Ability::ALL.into_iter().find(|ability| ability.name() == name);
        Self::of(text.split(',').map(of_name).collect::<Option<Vec<_>>>()?)
    }
}

/// For a sentence: "read and localize".
impl std::fmt::Display for Abilities {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(&listed(self.iter().map(Ability::name)))
    }
}

/// As many maps are named in a sentence.
const MOST_TOLD: usize = 5;

/// The maps that a token reaches.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Reach {
    Everywhere,
    /// Those that one of these is for: at least one, each a name, or the beginning of names and an asterisk.
    Maps(Vec<String>),
}

impl Reach {
    /// Of what was named; everywhere if nothing was.
    pub(crate) fn of(mut patterns: Vec<String>) -> Self {
        patterns.sort();
        patterns.dedup();
        if patterns.is_empty() { Self::Everywhere } else { Self::Maps(patterns) }
    }

    /// What was named; nothing for all maps.
    pub(crate) fn patterns(&self) -> &[String] {
        match self {
            Reach::Everywhere => &[],
            Reach::Maps(patterns) => patterns,
        }
    }

    pub(crate) fn has(&self, map: &str) -> bool {
        let is_for = |pattern: &String| match pattern.strip_suffix('*') {
            Some(beginning) => map.starts_with(beginning),
            None => map == pattern,
        };
        match self {
            Reach::Everywhere => true,
            Reach::Maps(patterns) => patterns.iter().any(is_for),
        }
    }

    /// As it is stored: names, with commas between them; `None` for all maps.
    pub(crate) fn to_text(&self) -> Option<String> {
        match self {
            Reach::Everywhere => None,
            Reach::Maps(patterns) => Some(patterns.join(",")),
        }
    }

    pub(crate) fn of_text(text: Option<&str>) -> Self {
        Self::of(text.into_iter().flat_map(|text| text.split(',')).map(str::to_owned).collect())
    }
}

/// For a sentence: "the maps hall and floor2-*".
impl std::fmt::Display for Reach {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Reach::Everywhere => out.write_str("all maps"),
            Reach::Maps(patterns) => {
                let noun = if patterns.len() == 1 { "the map" } else { "the maps" };
                let more = patterns.len().saturating_sub(MOST_TOLD);
                let more = (more > 0).then(|| format!("{more} more"));
                let told = patterns.iter().take(MOST_TOLD).map(String::as_str);
                write!(out, "{noun} {}", listed(told.chain(more.as_deref())))
            }
        }
    }
}

/// "one", "one and two", "one, two and three".
fn listed<'a>(words: impl Iterator<Item = &'a str>) -> String {
    let words: Vec<&str> = words.collect();
    match words.as_slice() {
        [before @ .., last] if !before.is_empty() => format!("{} and {last}", before.join(", ")),
        words => words.concat(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn abilities_and_maps_are_stored_as_they_are_read() {
        for role in [Role::Reader, Role::Robot, Role::Admin] {
            let all = role.abilities();
            assert_eq!(Abilities::of_text(&all.to_text()), Some(all));
            assert_eq!(Role::of_name(role.name()), Some(role));
        }
        for bad in ["", "read,", "Read", "write"] {
            assert_eq!(Abilities::of_text(bad), None, "{bad:?}");
        }
        for reach in [Reach::Everywhere, Reach::of(vec!["hall".to_owned(), "floor2-*".to_owned()])] {
            assert_eq!(Reach::of_text(reach.to_text().as_deref()), reach);
        }
    }

    #[test]
    fn maps_are_reached_by_name_or_by_its_beginning() {
        let reach = Reach::of(vec!["hall".to_owned(), "floor2-*".to_owned(), "hall".to_owned()]);
        for map in ["hall", "floor2-", "floor2-east"] {
            assert!(reach.has(map) && Reach::Everywhere.has(map), "{map}");
        }
        for map in ["", "hall2", "hal", "floor2", "floor20", "a-floor2-east"] {
            assert!(!reach.has(map), "{map}");
        }
        assert_eq!(reach.to_string(), "the maps floor2-* and hall");
        let many = Reach::of((0..7).map(|number| format!("map-{number}")).collect());
        assert_eq!(many.to_string(), "the maps map-0, map-1, map-2, map-3, map-4 and 2 more");
    }

    #[test]
    fn each_role_may_do_what_the_one_before_may_and_more() {
        let [reader, robot, admin] = [Role::Reader, Role::Robot, Role::Admin].map(Role::abilities);
        assert_eq!((reader.beyond(&robot), robot.beyond(&admin)), (None, None));
        assert_eq!(robot.beyond(&reader).unwrap().to_string(), "localize, stream and navigate");
        assert_eq!(admin.beyond(&robot).unwrap().to_string(), "admin");
    }
}
