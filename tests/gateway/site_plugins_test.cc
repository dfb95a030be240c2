// Plugins that come over the gateway's Thrift service.
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>
#include <thrift/transport/TSocket.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/gateway/site_service.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>

namespace iotcloud::gateway {
namespace {

using ::testing::HasSubstr;

class SitePluginsTest : public GatewayFixture {
 protected:
  SitePluginsTest() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-site-plugins-XXXXXX";
    folder_ = mkdtemp(pattern.data());
  }
  ~SitePluginsTest() override {
    if (transport_) transport_->close();
    service_.reset();
    gateway_.reset();
    std::filesystem::remove_all(folder_);
  }
  void serve(bool with_store = true) {
    auto wanted = options();
    if (with_store) {
      processes::PluginStore::Options store;
      store.folder = folder_;
      wanted.plugins = std::make_shared<processes::PluginStore>(store);
    }
    gateway_.emplace(std::move(wanted));
    gateway_->start();
    SiteService::Options listen;
    listen.listen.port = 0;
    service_.emplace(listen, *gateway_, *registry_, paths_);
    transport_ = std::make_shared<apache::thrift::transport::TFramedTransport>(
        std::make_shared<apache::thrift::transport::TSocket>("127.0.0.1", service_->port()));
    transport_->open();
    client_.emplace(std::make_shared<apache::thrift::protocol::TBinaryProtocol>(transport_));
  }
  static wire::TPluginOffer offer(const std::string& bytes) {
    wire::TPluginOffer offer;
    offer.__set_plugin("turtle.so");
    offer.__set_sha256(security::sha256_hex(bytes));
    offer.__set_size(static_cast<std::int64_t>(bytes.size()));
    return offer;
  }
  template <typename Call>
  static std::string refusal_of(Call&& call) {
    try {
      call();
    } catch (const wire::TSiteError& e) {
      return e.reason;
    }
    return "";
  }

  std::filesystem::path folder_;
  std::optional<SiteService> service_;
  std::shared_ptr<apache::thrift::transport::TFramedTransport> transport_;
  std::optional<wire::TSensorSiteServiceClient> client_;
};

TEST_F(SitePluginsTest, APluginOfAnyBytesComesInPiecesAndIsNotWantedAgain) {
  serve();
  std::string bytes;
  for (int i = 0; i < 300'000; ++i) bytes += static_cast<char>(i * 7);
  std::string upload;
  client_->offerPlugin(upload, offer(bytes));
  ASSERT_FALSE(upload.empty());
  client_->sendPlugin(upload, 0, bytes.substr(0, 200'000));
  client_->sendPlugin(upload, 200'000, bytes.substr(200'000));
  client_->finishPlugin(upload);
  EXPECT_TRUE(std::filesystem::exists(folder_ / security::sha256_hex(bytes) / "plugin.so"));
  client_->offerPlugin(upload, offer(bytes));
  EXPECT_TRUE(upload.empty());
}

TEST_F(SitePluginsTest, WhatIsRefusedIsSaidAndTheConnectionGoesOn) {
  serve();
  std::string upload;
  auto bad = offer("abc");
  bad.plugin = "../abc.so";
  EXPECT_THAT(refusal_of([&] { client_->offerPlugin(upload, bad); }), HasSubstr("not a plain file name"));
  EXPECT_THAT(refusal_of([&] { client_->sendPlugin("nobody", 0, "abc"); }), HasSubstr("no such upload"));
  EXPECT_THAT(refusal_of([&] { client_->finishPlugin("../.."); }), HasSubstr("no such upload"));
  client_->offerPlugin(upload, offer("abc"));
  EXPECT_THAT(refusal_of([&] { client_->sendPlugin(upload, 1, "bc"); }), HasSubstr("from 0 on are next"));
  wire::TPing ping;
  client_->ping(ping);
  EXPECT_EQ(ping.gateway, "gw");
}

TEST_F(SitePluginsTest, AGatewayWithoutAPlaceForThemSaysSo) {
  serve(false);
  std::string upload;
  EXPECT_THAT(refusal_of([&] { client_->offerPlugin(upload, offer("abc")); }), HasSubstr("takes no plugins"));
}

}  // namespace
}  // namespace iotcloud::gateway
