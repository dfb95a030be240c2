// Plugins that are sent: what is kept is whole, and what is not whole leaves nothing behind.
#include <atomic>
#include <future>

#include <sys/stat.h>

#include <iotcloud/processes/plugin_store.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/security/key_folder.h>

namespace iotcloud::processes {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

using security::error_of;
using tests::read_file;

/// Time that a test moves.
class MovedClock final : public config::Clock {
 public:
  Instant now() const override { return now_; }
  std::int64_t wall_ms() const override { return 1; }
  void move(std::chrono::milliseconds by) { now_ += by; }

 private:
  Instant now_{std::chrono::hours{1}};
};

class PluginStoreTest : public security::KeyFolder {
 protected:
  PluginStoreTest() { open(); }

  void open(bool signature_required = false) {
    store_.reset();
    PluginStore::Options options;
    options.folder = folder_ / "kept";
    options.most_bytes = 1000;
    options.most_uploads = 2;
    options.idle_limit = 1min;
    options.unnamed_limit = 10min;
    options.trust = trust(signature_required);
    options.clock = &clock_;
    options.new_upload_id = new_upload_id_;
    options.remove_folder = remove_folder_;
    store_ = std::make_unique<PluginStore>(options);
  }
  PluginStore::Offer offer(const std::string& bytes, const std::string& signature = "") const {
    return {"turtle.so", security::sha256_hex(bytes), static_cast<std::int64_t>(bytes.size()), signature};
  }
  std::string send(const std::string& bytes, const std::string& signature = "") {
    auto upload = store_->offer(offer(bytes, signature));
    if (upload.empty()) return "";
    store_->add(upload, 0, bytes);
    store_->finish(upload);
    return upload;
  }
  bool has(const std::string& bytes) const { return store_->path_of(security::sha256_hex(bytes)).has_value(); }
  /// Everything below the folder but the two folders that are always there.
  int files() const {
    int count = -1;  // incoming/
    for (const auto& file : fs::recursive_directory_iterator(folder_ / "kept")) count += file.exists() ? 1 : 0;
    return count;
  }

  MovedClock clock_;
  std::function<std::string()> new_upload_id_;
  std::function<void(const std::string&)> remove_folder_;
  std::unique_ptr<PluginStore> store_;
};

/// Where a thread of the store stands until the test lets it go on.
class Barrier {
 public:
  void stand() {
    here_ = true;
    EXPECT_TRUE(tests::eventually([&] { return open_.load(); }));
  }
  bool wait_for_one() const {
    return tests::eventually([&] { return here_.load(); });
  }
  void open() { open_ = true; }

 private:
  std::atomic<bool> here_{false}, open_{false};
};

/// Half as long as who stands at the barrier waits, so that a test that fails comes to its end.
constexpr auto while_it_stands = tests::patience / 2;

TEST_F(PluginStoreTest, WhatIsSentInPiecesIsKeptByItsContentForTheNextLifeToo) {
  const std::string bytes = "a plugin in three pieces";
  const auto upload = store_->offer(offer(bytes));
  ASSERT_FALSE(upload.empty());
  store_->add(upload, 0, bytes.substr(0, 5));
  store_->add(upload, 5, bytes.substr(5, 7));
  store_->add(upload, 12, bytes.substr(12));
  EXPECT_FALSE(has(bytes)) << "before it was checked";
  store_->finish(upload);
  open();
  const auto path = store_->path_of(security::sha256_hex(bytes)).value();
  EXPECT_EQ(read_file(path), bytes);
  struct stat status {};
  ASSERT_EQ(stat(path.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0222, 0u) << "nobody writes there any more";
  EXPECT_EQ(store_->uploads(), 0);
}

TEST_F(PluginStoreTest, WhatIsHereAlreadyIsNotSentAgain) {
  ASSERT_FALSE(send("abc").empty());
  EXPECT_TRUE(send("abc").empty());
  EXPECT_FALSE(send("abd").empty());
}

TEST_F(PluginStoreTest, AHalfUploadOfAnEarlierLifeIsClearedAway) {
  const auto upload = store_->offer(offer("abcdef"));
  store_->add(upload, 0, "abc");
  EXPECT_GT(files(), 0);
  // As a process that is killed leaves it: copied while the store lives, which clears up after itself.
  fs::copy(folder_ / "kept", folder_ / "as left", fs::copy_options::recursive);
  store_.reset();
  fs::remove_all(folder_ / "kept");
  fs::rename(folder_ / "as left", folder_ / "kept");
  EXPECT_GT(files(), 0);
  open();
  EXPECT_EQ(files(), 0);
  EXPECT_FALSE(has("abcdef"));
  EXPECT_THAT(error_of([&] { store_->add(upload, 3, "def"); }), HasSubstr("no such upload"));
}

TEST_F(PluginStoreTest, OtherBytesThanWereOfferedAreNotKept) {
  auto wrong = offer("abcdef");
  const auto upload = store_->offer(wrong);
  store_->add(upload, 0, "abcdeF");
  EXPECT_THAT(error_of([&] { store_->finish(upload); }),
              AllOf(HasSubstr(security::sha256_hex("abcdeF")), HasSubstr(security::sha256_hex("abcdef"))));
  EXPECT_EQ(files(), 0);
  EXPECT_EQ(store_->uploads(), 0);
}

TEST_F(PluginStoreTest, PiecesThatAreNotTheNextOnesEndTheUpload) {
  for (const std::int64_t offset : {0, 2, 4, -1}) {
    const auto upload = store_->offer(offer("abcdef"));
    store_->add(upload, 0, "abc");
    EXPECT_THAT(error_of([&] { store_->add(upload, offset, "d"); }), HasSubstr("from 3 on are next")) << offset;
    EXPECT_THAT(error_of([&] { store_->add(upload, 3, "def"); }), HasSubstr("no such upload"));
    EXPECT_EQ(files(), 0);
  }
}

TEST_F(PluginStoreTest, MoreOrFewerBytesThanOfferedAreRefused) {
  auto upload = store_->offer(offer("abc"));
  EXPECT_THAT(error_of([&] { store_->add(upload, 0, "abcd"); }), HasSubstr("more bytes came than the 3"));
  upload = store_->offer(offer("abc"));
  store_->add(upload, 0, "ab");
  EXPECT_THAT(error_of([&] { store_->finish(upload); }), HasSubstr("2 of 3 bytes"));
  EXPECT_EQ(files(), 0);
}

TEST_F(PluginStoreTest, WhatCannotBeIsRefusedBeforeAByteIsSent) {
  for (const std::string name : {"", "..", "../x.so", "a/b.so", "/etc/x.so", "a\nb.so"}) {
    auto bad = offer("abc");
    bad.file = name;
    EXPECT_NE(error_of([&] { store_->offer(bad); }), "") << name;
  }
  auto bad = offer("abc");
  bad.sha256 = "../../../etc";
  EXPECT_THAT(error_of([&] { store_->offer(bad); }), HasSubstr("64 hexadecimal digits"));
  bad = offer("abc");
  bad.size = 0;
  EXPECT_THAT(error_of([&] { store_->offer(bad); }), HasSubstr("is empty"));
  bad.size = 1001;
  EXPECT_THAT(error_of([&] { store_->offer(bad); }), AllOf(HasSubstr("1000"), HasSubstr("plugins.upload_limit_mb")));
  EXPECT_THAT(error_of([&] { store_->offer(offer("abc", "short")); }), HasSubstr("has 5 bytes"));
  EXPECT_EQ(files(), 0);
}

TEST_F(PluginStoreTest, OnlySoManyAreTakenAtATimeAndOneThatNobodyGoesOnWithEnds) {
  const auto idle = store_->offer(offer("one"));
  clock_.move(30s);
  const auto busy = store_->offer(offer("two"));
  EXPECT_THAT(error_of([&] { store_->offer(offer("three")); }), HasSubstr("only 2 plugins are taken at a time"));
  clock_.move(30s);
  EXPECT_FALSE(store_->offer(offer("three")).empty());
  EXPECT_THAT(error_of([&] { store_->add(idle, 0, "one"); }), HasSubstr("no such upload"));
  store_->add(busy, 0, "two");
  store_->finish(busy);
  clock_.move(1min);
  store_->clean({});
  EXPECT_EQ(store_->uploads(), 0);
}

TEST_F(PluginStoreTest, WhatNoOrderNamesAnyMoreGoesAfterAWhile) {
  send("kept");
  send("unnamed");
  send("asked for");
  const auto clean = [&] { store_->clean({security::sha256_hex("kept")}); };
  clean();
  clock_.move(9min);
  EXPECT_TRUE(send("asked for").empty());
  clean();
  EXPECT_TRUE(has("unnamed"));
  clock_.move(1min);
  clean();
  EXPECT_TRUE(has("kept") && has("asked for"));
  EXPECT_FALSE(has("unnamed"));
  clock_.move(1h);
  clean();
  EXPECT_TRUE(has("kept"));
  EXPECT_FALSE(has("asked for"));
  EXPECT_EQ(files(), 2) << "a folder and the plugin in it";
}

TEST_F(PluginStoreTest, NobodyWaitsWhileAPluginIsRemovedButWhoSendsItAgain) {
  Barrier removal;
  remove_folder_ = [&](const std::string& folder) {
    removal.stand();
    fs::remove_all(folder);
  };
  open();
  send("unnamed");
  clock_.move(10min);
  auto cleaning = std::async(std::launch::async, [&] { store_->clean({}); });
  ASSERT_TRUE(removal.wait_for_one());
  auto other = std::async(std::launch::async, [&] { return send("other"); });
  ASSERT_EQ(other.wait_for(while_it_stands), std::future_status::ready);
  EXPECT_TRUE(has("other"));
  auto again = std::async(std::launch::async, [&] { return send("unnamed"); });
  removal.open();
  EXPECT_FALSE(again.get().empty()) << "it was gone";
  cleaning.get();
  EXPECT_TRUE(has("unnamed"));
  store_->clean({});
  EXPECT_TRUE(has("unnamed")) << "it was wanted just now";
}

TEST_F(PluginStoreTest, NobodyWaitsWhileTheFilesOfAnUploadAreMade) {
  Barrier making;
  std::atomic<int> ids{0};
  new_upload_id_ = [&] {
    const int id = ++ids;
    if (id == 1) making.stand();
    return std::to_string(id);
  };
  open();
  auto slow = std::async(std::launch::async, [&] { return store_->offer(offer("slow")); });
  ASSERT_TRUE(making.wait_for_one());
  auto other = std::async(std::launch::async, [&] { return store_->offer(offer("other")); });
  ASSERT_EQ(other.wait_for(while_it_stands), std::future_status::ready);
  EXPECT_THAT(error_of([&] { store_->offer(offer("third")); }), HasSubstr("only 2 plugins are taken at a time"))
      << "the one that is made counts";
  making.open();
  EXPECT_FALSE(slow.get().empty());
  EXPECT_EQ(store_->uploads(), 2);
}

TEST_F(PluginStoreTest, ADamagedPluginIsTakenAnew) {
  send("abc");
  const auto path = store_->path_of(security::sha256_hex("abc")).value();
  fs::permissions(path, fs::perms::owner_write, fs::perm_options::add);
  std::ofstream(path) << "abd";
  EXPECT_FALSE(send("abc").empty());
  EXPECT_EQ(read_file(path), "abc");
}

TEST_F(PluginStoreTest, TwoWhoSendTheSameAtTheSameTimeBothSucceed) {
  const auto one = store_->offer(offer("abc")), two = store_->offer(offer("abc", signature_of("abc")));
  store_->add(one, 0, "abc");
  store_->add(two, 0, "abc");
  store_->finish(one);
  store_->finish(two);
  EXPECT_EQ(read_file(store_->path_of(security::sha256_hex("abc")).value()), "abc");
  EXPECT_EQ(read_file(store_->signature_path_of(security::sha256_hex("abc"))), signature_of("abc"));
  EXPECT_EQ(files(), 3);
}

TEST_F(PluginStoreTest, WithoutASignatureNothingIsTakenWhereOneIsRequired) {
  open(true);
  EXPECT_THAT(error_of([&] { store_->offer(offer("abc")); }), HasSubstr("is not signed"));
  const auto upload = store_->offer(offer("abc", signature_of("another")));
  store_->add(upload, 0, "abc");
  EXPECT_THAT(error_of([&] { store_->finish(upload); }), HasSubstr("changed after it was signed"));
  EXPECT_EQ(files(), 0);
  EXPECT_FALSE(send("abc", signature_of("abc")).empty());
  EXPECT_TRUE(has("abc"));
}

TEST_F(PluginStoreTest, ASignatureThatComesLaterIsKeptAndNoWorseOneTakesItsPlace) {
  send("abc");
  const auto path = store_->signature_path_of(security::sha256_hex("abc"));
  EXPECT_FALSE(fs::exists(path));
  EXPECT_TRUE(send("abc", signature_of("abc")).empty());
  EXPECT_EQ(read_file(path), signature_of("abc"));
  EXPECT_TRUE(send("abc", signature_of("another")).empty());
  EXPECT_EQ(read_file(path), signature_of("abc"));
}

TEST_F(PluginStoreTest, WhatIsNoHashIsNowhere) {
  send("abc");
  EXPECT_EQ(store_->path_of("incoming"), std::nullopt);
  EXPECT_EQ(store_->path_of(security::sha256_hex("abd")), std::nullopt);
}

}  // namespace
}  // namespace iotcloud::processes
