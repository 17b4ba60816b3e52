// The C++ client of Waypost: place recognition, mapping and navigation of robots. Begin with `waypost::Client`.
#pragma once

#include "waypost/client.hpp"      // IWYU pragma: export
#include "waypost/errors.hpp"      // IWYU pragma: export
#include "waypost/frame.hpp"       // IWYU pragma: export
#include "waypost/navigation.hpp"  // IWYU pragma: export
#include "waypost/options.hpp"     // IWYU pragma: export
#include "waypost/session.hpp"     // IWYU pragma: export
