// The same images give the same decisions, from this client and from the command line.
#include <google/protobuf/struct.pb.h>
#include <google/protobuf/util/json_util.h>
#include <gtest/gtest.h>

#include <map>

#include "support.hpp"

namespace {

using namespace support;
using namespace waypost;

google::protobuf::Struct streamed_by_command_line(const Server& server, const std::string& map) {
  const Ran ran = run({binary("waypost"), "--server", "http://" + server.address(), "--json", "stream",
                       WAYPOST_REPOSITORY "/demo/sequence", "--map", map, "--session", "drive"});
  google::protobuf::Struct report;
  const std::string json = ran.output.substr(ran.output.find("\n{") == std::string::npos ? 0 : ran.output.find("\n{"));
  EXPECT_EQ(ran.code, 0) << ran.output;
  EXPECT_TRUE(google::protobuf::util::JsonStringToMessage(json, &report).ok()) << ran.output;
  return report;
}

// The number or the word of a field; none where it is null.
std::string text(const google::protobuf::Value& value) {
  if (value.has_number_value()) return std::to_string(value.number_value());
  return value.string_value();
}

// What `waypost stream --json` prints of an answer, but for the times.
std::map<std::string, std::string> row_of(const FrameAnswer& answer) {
  const auto number = [](auto value) { return std::to_string(static_cast<double>(value)); };
  std::string reason = v1::Reason_Name(answer.reason()).substr(std::string("REASON_").size());
  for (char& letter : reason) letter = static_cast<char>(std::tolower(letter));
  std::map<std::string, std::string> row = {
      {"sequence", number(answer.sequence())},
      {"reason", reason},
      {"place_number", answer.has_place_number() ? number(answer.place_number()) : ""},
      {"posterior", number(answer.posterior())},
      {"new_place_posterior", number(answer.new_place_posterior())},
      {"words", number(answer.words())},
  };
  if (answer.has_match()) {
    row["match_place_number"] = number(answer.match().place_number());
    row["match_sequence"] = number(answer.match().frame().sequence());
    row["match_log_odds"] = number(answer.match().log_odds());
  }
  return row;
}

std::vector<FrameAnswer> streamed(const Client& client, const std::string& map) {
  Session session = client.open_session({map, "drive"});
  std::vector<FrameAnswer> answers;
  for (std::uint64_t sequence = 1; sequence <= images().size(); ++sequence) {
    session.post(frame(sequence));
    while (auto outcome = session.receive_for(0s)) answers.push_back(outcome->answer());
  }
  session.finish();
  while (auto outcome = session.receive()) answers.push_back(outcome->answer());
  return answers;
}

TEST(Decisions, AreThoseThatTheCommandLineGets) {
  const TemporaryFolder folder;
  const Server server(folder / "data");
  const Client client = Client::connect(server.address());
  client.create_map("cpp", "shipped");
  client.create_map("command-line", "shipped");

  const auto report = streamed_by_command_line(server, "command-line");
  const auto answers = streamed(client, "cpp");

  const auto& rows = report.fields().at("frames").list_value().values();
  ASSERT_EQ(static_cast<std::size_t>(rows.size()), images().size());
  ASSERT_EQ(answers.size(), images().size());
  std::uint64_t closures = 0;
  for (std::size_t at = 0; at < answers.size(); ++at) {
    EXPECT_EQ(answers[at].sequence(), at + 1);
    const auto& expected = rows[static_cast<int>(at)].struct_value().fields();
    for (const auto& [name, value] : row_of(answers[at])) {
      EXPECT_EQ(value, text(expected.at(name))) << name << " of frame " << at + 1;
    }
    if (answers[at].reason() == v1::REASON_LOOP_CLOSURE) ++closures;
  }

  EXPECT_GE(closures, 10U) << "the shipped drive closes loops";
  EXPECT_EQ(client.loop_closures("cpp").size(), closures);
  const v1::Map own = client.map("cpp", v1::MAP_VIEW_FULL);
  EXPECT_EQ(own.loop_closures(), closures);
  EXPECT_EQ(own.state_hash(), client.map("maps/command-line", v1::MAP_VIEW_FULL).state_hash());
}

}  // namespace
