// Addresses, the environment, tokens and certificates, as the command line takes them.
#include <gtest/gtest.h>

#include <fstream>

#include "support.hpp"

namespace {

using namespace support;
using namespace waypost;

// While no server runs; gives the secret.
std::string create_token(const std::filesystem::path& data_dir, const std::string& name, const std::string& role) {
  const Ran ran = run({binary("waypost-server"), "token", "create", name, "--role", role, "--data-dir", data_dir});
  const std::size_t begin = ran.output.find("waypost_");
  if (ran.code != 0 || begin == std::string::npos) throw std::runtime_error(ran.output);
  return ran.output.substr(begin, ran.output.find_first_of(" \n", begin) - begin);
}

ClientOptions with_token(const std::string& address, const std::string& token) {
  ClientOptions options(address);
  options.token = token;
  return options;
}

TEST(Connecting, AddressesAreWrittenInSeveralWays) {
  const TemporaryFolder folder;
  const Server server(folder / "data");
  for (const std::string& address : {server.address(), "http://" + server.address(), "http://" + server.address() + "/"}) {
    EXPECT_TRUE(Client::connect(address).maps().empty()) << address;
  }
  const std::string said = thrown<ServerUnreachable>([&] { Client::connect(server.http_address()); });
  EXPECT_NE(said.find("7600 unless set otherwise"), std::string::npos) << said;
  thrown<ServerUnreachable>([&] { Client::connect("https://" + server.address()); });

  const Variable variable("WAYPOST_SERVER", "http://" + server.address());
  // Empty counts as unset.
  const Variable token("WAYPOST_TOKEN", "");
  EXPECT_TRUE(Client::connect().maps().empty());
}

TEST(Connecting, NobodyAtTheAddressIsSaidAtOnce) {
  const auto begin = std::chrono::steady_clock::now();
  // No server listens there: the port is reserved.
  const std::string said = thrown<ServerUnreachable>([] { Client::connect("127.0.0.1:1"); });
  EXPECT_NE(said.find("check that waypost-server runs"), std::string::npos) << said;
  EXPECT_LT(std::chrono::steady_clock::now() - begin, 6s);
}

TEST(Connecting, AFrozenServerIsNotWaitedForLongerThanAsked) {
  const TemporaryFolder folder;
  Server server(folder / "data");
  ClientOptions options(server.address());
  // Long enough to connect on a busy machine.
  options.call_timeout = 2s;
  const Client client = Client::connect(options);
  server.freeze();
  const auto begin = std::chrono::steady_clock::now();
  thrown<ServerUnreachable>([&] { client.maps(); });
  EXPECT_LT(std::chrono::steady_clock::now() - begin, 20s);
  server.thaw();
}

TEST(Connecting, ATokenOpensWhatItIsFor) {
  const TemporaryFolder folder;
  const auto data_dir = folder / "data";
  const std::string admin = create_token(data_dir, "operator", "admin");
  const std::string robot = create_token(data_dir, "robot", "robot");
  const Server server(data_dir);
  const std::string missing = thrown<Unauthenticated>([&] { Client::connect(server.address()); });
  EXPECT_NE(missing.find("token"), std::string::npos) << missing;
  const std::string wrong = thrown<Unauthenticated>([&] { Client::connect(with_token(server.address(), "waypost_0")); });
  EXPECT_NE(wrong.find("token"), std::string::npos) << wrong;
  const Client stranger = Client::lazy(server.address());
  thrown<Unauthenticated>([&] { stranger.open_session({"hall"}); });

  Client::connect(with_token(server.address(), admin)).create_map("hall", "shipped");
  // As it is read from a file.
  const Client client = Client::connect(with_token(server.address(), robot + "\n"));
  EXPECT_EQ(client.open_session({"hall"}).send(frame(1)).sequence(), 1U);
  EXPECT_NE(thrown<PermissionDenied>([&] { client.create_map("cellar"); }).find("admin"), std::string::npos);
  const Variable variable("WAYPOST_TOKEN", robot);
  EXPECT_EQ(Client::connect(server.address()).map("hall").frames(), 1U);
  thrown<InvalidUse>([&] { Client::lazy(with_token(server.address(), "w\xc3\xa4ypost")); });
}

// A server that demands certificates of its clients, and whom it knows.
class Certified : public ::testing::Test {
 protected:
  void SetUp() override {
    openssl({"req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=authority", "-keyout", "ca.key", "-out", "ca.crt"});
    std::ofstream(folder / "names") << "subjectAltName=DNS:localhost\n";
    for (const std::string name : {"server", "robot"}) {
      openssl({"req", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=" + name, "-keyout", name + ".key", "-out", name + ".csr"});
      openssl({"x509", "-req", "-in", name + ".csr", "-CA", "ca.crt", "-CAkey", "ca.key", "-CAcreateserial", "-extfile",
               "names", "-out", name + ".crt"});
    }
  }
  void openssl(std::vector<std::string> arguments) {
    std::string command = "cd '" + (folder / "").string() + "' && openssl";
    for (const std::string& argument : arguments) command += " " + argument;
    const Ran ran = run({"sh", "-c", command});
    ASSERT_EQ(ran.code, 0) << ran.output;
  }

  TemporaryFolder folder;
};

TEST_F(Certified, ACertificateLetsAClientIn) {
  const Server server(folder / "data", {"--tls-certificate", folder / "server.crt", "--tls-key", folder / "server.key",
                                        "--tls-client-ca", folder / "ca.crt"});
  ClientOptions options("https://localhost:" + server.address().substr(server.address().rfind(':') + 1));
  thrown<ServerUnreachable>([&] { Client::connect(options); });
  options.ca_file = folder / "ca.crt";
  thrown<ServerUnreachable>([&] { Client::connect(options); });
  options.client_certificate_file = folder / "robot.crt";
  EXPECT_NE(thrown<InvalidUse>([&] { Client::connect(options); }).find("go together"), std::string::npos);
  options.client_key_file = folder / "robot.key";
  const Client client = Client::connect(options);
  client.create_map("hall");
  EXPECT_EQ(client.open_session({"hall"}).send(frame(1)).sequence(), 1U);

  options.address = "http://127.0.0.1:7600";
  EXPECT_NE(thrown<InvalidUse>([&] { Client::lazy(options); }).find("not encrypted"), std::string::npos);
  options.address.reset();
  options.ca_file = folder / "robot.key";
  EXPECT_NE(thrown<InvalidUse>([&] {
              options.address = "https://localhost:1";
              Client::lazy(options);
            }).find("not in PEM"), std::string::npos);
  options.ca_file = folder / "absent";
  EXPECT_NE(thrown<InvalidUse>([&] { Client::lazy(options); }).find("cannot read"), std::string::npos);
}

}  // namespace
