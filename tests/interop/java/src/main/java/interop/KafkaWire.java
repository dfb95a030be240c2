package interop;

import interop.original.TChannel;
import interop.original.TSensorMessage;
import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import java.time.Duration;
import java.util.ArrayList;
import java.util.HashMap;
import java.util.List;
import java.util.Map;
import java.util.Properties;
import java.util.function.Consumer;
import org.apache.kafka.clients.consumer.KafkaConsumer;
import org.apache.kafka.clients.producer.KafkaProducer;
import org.apache.kafka.clients.producer.ProducerRecord;
import org.apache.kafka.common.serialization.ByteArrayDeserializer;
import org.apache.kafka.common.serialization.ByteArraySerializer;
import org.apache.kafka.common.utils.Utils;

/** Records whose key is the instance and whose value is a TSensorMessage. */
final class KafkaWire implements Wire {
    private final String servers;
    private final KafkaProducer<byte[], byte[]> producer;
    private final List<Thread> readers = new ArrayList<>();
    private volatile boolean ending = false;

    KafkaWire(String url) {
        servers = url.replaceFirst("^kafka://", "");
        var settings = settings();
        settings.put("linger.ms", "0");
        producer = new KafkaProducer<>(settings, new ByteArraySerializer(), new ByteArraySerializer());
    }

    private Properties settings() {
        var settings = new Properties();
        settings.put("bootstrap.servers", servers);
        return settings;
    }

    @Override
    public void read(TChannel channel, Consumer<Message> handler) {
        String topic = Wire.name(channel, "topic");
        var settings = settings();
        settings.put("group.id", topic);
        settings.put("auto.offset.reset", "earliest");
        settings.put("metadata.max.age.ms", "500");  // the topic may come later
        var reader = new Thread(() -> {
            try (var consumer = new KafkaConsumer<>(settings, new ByteArrayDeserializer(), new ByteArrayDeserializer())) {
                consumer.subscribe(List.of(topic));
                while (!ending) {
                    for (var record : consumer.poll(Duration.ofMillis(100))) {
                        // Java's own choice for this key.
                        int partition = Utils.toPositive(Utils.murmur2(record.key())) % consumer.partitionsFor(topic).size();
                        handler.accept(parse(record.key(), record.value(), record.partition() == partition));
                    }
                }
            }
        });
        readers.add(reader);
        reader.start();
    }

    /** What is wrong with the record beside its headers is a header of the message, which nobody expects. */
    private static Message parse(byte[] key, byte[] value, boolean inItsPartition) {
        try {
            var message = Records.parse(new TSensorMessage(), value);
            Map<String, String> headers = new HashMap<>();
            if (message.getProperties() != null) headers.putAll(message.getProperties());
            headers.put(Message.SENSOR, message.getSensorId());
            headers.put(Message.SITE, message.getSite());
            if (!message.getSensorId().equals(new String(key, StandardCharsets.UTF_8))) headers.put("key", "wrong");
            if (!inItsPartition) headers.put("partition", "wrong");
            return new Message(message.getBody(), headers);
        } catch (Exception error) {
            return Message.of("unreadable: " + error, Map.of());
        }
    }

    @Override
    public void open(TChannel channel) {}

    @Override
    public void write(TChannel channel, Message message) throws Exception {
        Map<String, String> properties = new HashMap<>(message.headers());
        String sensor = properties.remove(Message.SENSOR);
        String site = properties.remove(Message.SITE);
        var record = new TSensorMessage();
        record.setSensorId(sensor);
        record.setSite(site);
        record.setBody(ByteBuffer.wrap(message.body()));
        record.setProperties(properties);
        producer.send(new ProducerRecord<>(Wire.name(channel, "topic"), sensor.getBytes(StandardCharsets.UTF_8),
                Records.bytes(record)));
        producer.flush();
    }

    @Override
    public void close() throws Exception {
        ending = true;
        for (Thread reader : readers) reader.join();
        producer.close();
    }
}
