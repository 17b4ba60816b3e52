// Frames as the contract has them.
#pragma once

#include "waypost/frame.hpp"
#include "waypost/v1/session.pb.h"

namespace waypost {

v1::Frame message_of(Frame frame);

}  // namespace waypost
