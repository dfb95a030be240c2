#include <gtest/gtest.h>

#include <iotcloud/master/listing/secret_properties.h>

namespace iotcloud::master {
namespace {

TEST(SecretProperties, AreKnownByTheirNames) {
  for (const char* key : {"password", "Device.PASSWORD", "wifi_passphrase", "clientSecret", "api_Token", "key",
                          "api-key", "apiKey", "key2", "aws.access_key", "credentials"})
    EXPECT_TRUE(is_secret(key, "x")) << key;
  for (const char* key : {"rate", "monkey", "keyboard", "keep_last", "keys_pressed", "channel.data.priority"})
    EXPECT_FALSE(is_secret(key, "x")) << key;
}

TEST(SecretProperties, AreUrlsWithAPassword) {
  EXPECT_TRUE(is_secret("source", "rtsp://admin:sesame@camera:554/1"));
  EXPECT_TRUE(is_secret("source", "http://:sesame@camera"));
  EXPECT_TRUE(is_secret("urls", "amqp://h1/ amqp://robot:sesame@h2/")) << "not the first of several";
  EXPECT_TRUE(is_secret("cameras", "http://camera1,http://admin:sesame@camera2"));
  EXPECT_TRUE(is_secret("source", "amqp://robot:8/sesame@h1/")) << "a password that begins like a port";
  EXPECT_FALSE(is_secret("urls", "amqp://h1:5672/ amqp://h2:5672/"));
  EXPECT_FALSE(is_secret("source", "ssh://robot@camera:22/"));
  EXPECT_FALSE(is_secret("note", "a:b@c"));
}

}  // namespace
}  // namespace iotcloud::master
