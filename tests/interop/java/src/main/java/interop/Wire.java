package interop;

import interop.original.TChannel;
import java.util.function.Consumer;

/** A broker as the original's transports use it. */
interface Wire extends AutoCloseable {
    /** Begins to read a channel; calls back for each message, on one thread. */
    void read(TChannel channel, Consumer<Message> handler) throws Exception;

    /** What a writer declares before it sends. */
    void open(TChannel channel) throws Exception;

    void write(TChannel channel, Message message) throws Exception;

    @Override
    void close() throws Exception;

    static Wire of(String kind, String server) throws Exception {
        return kind.equals("kafka") ? new KafkaWire(server) : new RabbitWire(server);
    }

    /** The channel's property on the wire: it holds the name that the driver gave, the prefix comes from the record. */
    static String name(TChannel channel, String property) {
        String given = channel.getProperties().get(property);
        if (given == null) throw new IllegalStateException("the channel's record has no property " + property);
        String prefix = channel.getSite() + "." + channel.getSensor() + ".";
        return (channel.isGrouped() ? prefix : prefix + channel.getSensorId() + ".") + given;
    }
}
